"""Lulls: what telemetry does begins where the loop has room for all of it, and never waits longer than a period."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rtagent.telemetry.lull import GUARD, LONGEST, Lull, Pace

PERIOD = 2_000_000
LAST_CALL = round((1 - GUARD) * PERIOD)


def heard(period: int, busy: int, *, first: str = "observe") -> Lull:
    """Return what knows of two cycles that were busy for so long, the newest of which began at ten periods."""
    lull = Lull(Pace(period, first))
    for began in (9 * period, 10 * period):
        middle = began + busy // 2
        lull.heard([("component", ("observe", began, middle)), ("component", ("act", middle, began + busy))])
    return lull


def test_it_waits_until_a_cycle_is_over_and_not_into_the_next() -> None:
    lull = heard(PERIOD, 300_000)
    lull.took(100_000)
    assert lull.until(12 * PERIOD) == 300_000
    assert heard(PERIOD, 300_000).until(12 * PERIOD + 299_999) == 1
    assert heard(PERIOD, 300_000).until(12 * PERIOD + 300_000) == 0


def test_nothing_begins_where_it_may_still_be_passed_on_when_the_next_cycle_is_due() -> None:
    lull = heard(PERIOD, 300_000)
    lull.took(100_000)
    assert lull.until(12 * PERIOD + LAST_CALL - 100_000) == 0
    assert lull.until(12 * PERIOD + LAST_CALL - 99_999) == PERIOD - LAST_CALL + 99_999 + 300_000


def test_a_cycle_goes_on_after_its_calls_were_told() -> None:
    lull = Lull(Pace(PERIOD, "observe"))
    lull.heard([("component", ("observe", PERIOD, PERIOD + 100_000)), ("acted", ())])
    learned = ("component", ("learn", PERIOD + 100_000, PERIOD + 500_000))
    lull.heard([learned, ("component", ("observe", 2 * PERIOD, 2 * PERIOD + 100_000))])
    assert lull.until(2 * PERIOD + 200_000) == 300_000


TIMES = st.integers(0, PERIOD)


@given(busy=TIMES, piece=TIMES, now=st.integers(0, 40 * PERIOD), count=st.integers(1, 30))
def test_what_begins_ends_before_the_next_cycle(busy: int, piece: int, now: int, count: int) -> None:
    lull = heard(PERIOD, busy)
    for _ in range(count):
        lull.took(piece)
    wait = lull.until(now)
    assert 0 <= wait <= PERIOD
    if busy + piece < LAST_CALL:
        phase = (now + wait) % PERIOD
        assert busy <= phase <= LAST_CALL - piece
    else:
        assert wait == 0


def test_a_run_without_a_period_or_with_a_long_one_is_not_waited_for() -> None:
    assert heard(LONGEST, LONGEST // 3).until(10 * LONGEST)
    assert heard(LONGEST + 1, LONGEST // 3).until(10 * (LONGEST + 1)) == 0
    assert not Lull(Pace()).known


def test_a_long_cycle_is_forgotten_in_time() -> None:
    assert heard(PERIOD, 1_000_000).until(12 * PERIOD + 700_000)
    lull = heard(PERIOD, 1_000_000)
    for began in range(11, 200):
        lull.heard([("component", ("observe", began * PERIOD, began * PERIOD + 100_000))])
    assert lull.until(200 * PERIOD + 700_000) == 0


@given(busy=st.integers(0, LAST_CALL), piece=st.integers(0, LAST_CALL), late=st.integers(1_000, 100_000))
def test_a_long_piece_keeps_nobody_out_who_always_wakes_late(busy: int, piece: int, late: int) -> None:
    lull, now = heard(PERIOD, busy), 12 * PERIOD
    lull.took(piece)
    for _ in range(30):
        wait = lull.until(now)
        if not wait:
            return
        now += wait + late
    raise AssertionError("it was kept out for 30 looks")
