"""The board's clock, fitted to the host's, against boards whose true times are known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from random import Random

import pytest

from rtagent.units import ms, second, us
from rtagent_drivers.arduino.board_clock import BoardClock

EPOCH = 10**15
RATE = 750
WITHIN = 200 * us


def independent(rng: Random) -> Callable[[int], int]:
    """Each arrival is late by itself, so that some overtake others."""
    return lambda taken: taken + rng.randrange(10 * ms)


def busy(rng: Random) -> Callable[[int], int]:
    """The host looks now and then, at most 10 ms after it looked last, and finds all that has come."""
    looks = [0]

    def arrival(taken: int) -> int:
        while looks[0] < taken:
            looks[0] += rng.randrange(10 * ms)
        return looks[0]

    return arrival


def errors(
    clock: BoardClock, arrival: Callable[[int], int], drift: float = 0.0, seconds: int = 20, latency: int = 0
) -> Iterator[tuple[int, int]]:
    """Yield, for each sample, when it was taken, and by how much the fit is wrong about that."""
    for number in range(RATE * seconds):
        taken = number * second // RATE
        micros = (4_294_000_000 + int(taken * (1.0 + drift)) // us) % 2**32  # wraps within the first second
        time = clock.unwrapped(micros)
        clock.hear(time, EPOCH + arrival(taken) + latency)
        yield taken, abs(clock.at(time) - taken - EPOCH)


@pytest.mark.parametrize("jitter", [independent, busy])
@pytest.mark.parametrize("drift", [0.0, 5e-5, -5e-3])
def test_times_are_right_though_arrivals_jitter_by_10_ms(
    jitter: Callable[[Random], Callable[[int], int]], drift: float
) -> None:
    clock = BoardClock(latency=3 * ms)
    found = list(errors(clock, jitter(Random(1)), drift, latency=3 * ms))
    assert max(error for taken, error in found if taken > second) < WITHIN
    assert clock.drift == pytest.approx(1.0 / (1.0 + drift) - 1.0, abs=1e-5)


def test_a_time_is_never_after_its_arrival() -> None:
    clock, rng = BoardClock(), Random(2)
    for number in range(5000):
        taken = number * ms
        arrival = taken + rng.randrange(10 * ms)
        clock.hear(taken, arrival)
        assert clock.at(taken) <= arrival + us


def test_a_board_that_stood_still_is_believed_again() -> None:
    clock = BoardClock()
    for number in range(20_000):
        taken = number * ms
        stood_still = 100 * ms if number > 10_000 else 0
        clock.hear(taken, taken + stood_still)
    assert abs(clock.at(taken) - taken - 100 * ms) < WITHIN


def test_a_drift_that_changes_is_followed() -> None:
    clock, worst = BoardClock(), 0
    for number in range(120 * 100):
        taken = number * 10 * ms
        seconds = taken / second
        board = taken + round(50_000 * seconds**2 / 1000)  # faster by 0.1 ppm each second, as one that warms up
        clock.hear(board, taken)
        worst = max(worst, abs(clock.at(board) - taken))
    assert worst < WITHIN
