"""When samples arrive: at every moment the newest is what a slow simulation says."""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
import pytest
from helpers import Scripted
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent_drivers.arrivals import Arrival, Arrivals, Disturbance

START = 10**15
BLOCK = 16
"""So many samples are drawn at first in these tests, so that much happens where more have to be drawn."""
SAMPLES = 64 * BLOCK


def arrivals_of(
    period: float, delay: int, jitter: int, disturbance: Disturbance | None, rng: np.random.Generator
) -> Arrivals:
    with mock.patch("rtagent_drivers.arrivals.FIRST_BLOCK", BLOCK):
        return Arrivals(START, period, delay, jitter, disturbance, rng)


class Plan:
    """A slow simulation: each sample's fate is known beforehand, and every question looks through all."""

    def __init__(
        self, period: float, delay: int, jitters: list[int], chances: np.ndarray, disturbance: Disturbance
    ) -> None:
        self.sent: list[Arrival] = []
        self.dropped: list[Arrival] = []
        for number, (jitter, chance) in enumerate(zip(jitters, chances, strict=True)):
            taken = START + round(number * period)
            drop, late, corrupt, double = (
                chance < (disturbance.drop, disturbance.late, disturbance.corrupt, disturbance.duplicate)
            ).tolist()
            arrival = taken + delay + jitter + (disturbance.lateness if late else 0)
            sample = Arrival(number, taken, arrival, corrupt)
            (self.dropped if drop else self.sent).extend([sample] * (2 if double and not drop else 1))

    def arrived(self, now: int) -> list[Arrival]:
        return [sample for sample in self.sent if sample.arrival <= now]

    def newest(self, now: int) -> Arrival | None:
        return max(self.arrived(now), key=lambda sample: sample.sequence, default=None)

    def next_arrival(self, now: int) -> int:
        return min(sample.arrival for sample in self.sent if sample.arrival > now)


PROBABILITY = st.sampled_from([0.0, 0.1, 0.5])
MOMENTS = st.lists(
    st.one_of(st.floats(-2, 9 * BLOCK), st.integers(BLOCK - 5, BLOCK + 3)),
    min_size=1,
    max_size=6,
)


@st.composite
def streams(draw: st.DrawFn) -> tuple[Arrivals, Plan, float]:
    """Return arrivals and the slow simulation of them; the period is in ns."""
    period = draw(st.sampled_from([10.0, 1e9 / 3, 100 / 3, 7.25]))
    delay, jitter = (draw(st.sampled_from([0, 1, math.ceil(period), math.ceil(5 * period)])) for _ in range(2))
    lateness = draw(st.sampled_from([0, math.ceil(period), math.ceil(40.4 * period)]))
    disturbance = Disturbance(*(draw(PROBABILITY) for _ in range(4)), lateness)
    drawing = np.random.default_rng(draw(st.integers(0, 2**32)))
    jitters = drawing.integers(0, jitter, SAMPLES, endpoint=True).tolist()
    chances = drawing.random((SAMPLES, 4))
    plan = Plan(period, delay, jitters, chances, disturbance)
    return arrivals_of(period, delay, jitter, disturbance, Scripted(jitters, chances)), plan, period


@given(streams(), MOMENTS)
@settings(max_examples=80)
def test_the_newest_sample_is_that_of_a_slow_simulation(
    stream: tuple[Arrivals, Plan, float], moments: list[float]
) -> None:
    arrivals, plan, period = stream
    for moment in moments:
        now = START + round(moment * period)
        assert arrivals.newest(now) == plan.newest(now)


@given(streams(), MOMENTS)
@settings(max_examples=80)
def test_the_next_arrival_is_not_later_than_in_a_slow_simulation(
    stream: tuple[Arrivals, Plan, float], moments: list[float]
) -> None:
    arrivals, plan, period = stream
    for moment in moments:
        now = START + round(moment * period)
        assert now < arrivals.next_arrival(now) <= plan.next_arrival(now)


@pytest.mark.slow
@given(streams())
@settings(max_examples=60)
def test_following_the_arrivals_one_by_one_meets_them_all(stream: tuple[Arrivals, Plan, float]) -> None:
    arrivals, plan, period = stream
    now, met, end = START - 1, set(), START + round(5 * BLOCK * period)
    while now < end:
        now = arrivals.next_arrival(now)
        met.add(now)
    expected = {sample.arrival for sample in plan.sent if sample.arrival <= now}
    assert expected <= met
    # it is also told to look again where more samples have to be drawn, which are twice as many each time
    assert len(met - expected) <= 5


@pytest.mark.parametrize("near", [-2, -1, 0, 1])
@pytest.mark.parametrize("period", [10.0, 1e9 / 30, 1e9 / 3])
def test_the_newest_at_the_very_moment_of_an_arrival_is_what_arrives(near: int, period: float) -> None:
    number = BLOCK + near
    arrivals = arrivals_of(period, 0, 0, None, np.random.default_rng(0))
    newest = arrivals.newest(START + round(number * period))
    assert newest == Arrival(number, START + round(number * period), START + round(number * period), False)


def test_a_late_sample_does_not_hide_those_that_overtake_it() -> None:
    fates = np.full((SAMPLES, 4), 0.9)
    fates[BLOCK - 3 : BLOCK, 1] = 0.0
    disturbance = Disturbance(0.0, 0.0, 0.0, late=0.5, lateness=200)
    arrivals = arrivals_of(10.0, 0, 0, disturbance, Scripted([0] * SAMPLES, fates))
    # the last three of the first block are late: the first of the second block comes before them
    assert arrivals.next_arrival(START + 10 * (BLOCK - 4)) == START + 10 * BLOCK


def test_the_first_sample_after_a_long_silence_is_not_slept_through() -> None:
    fates = np.full((8 * BLOCK, 4), 0.9)
    fates[BLOCK - 1, 1] = 0.0
    fates[BLOCK : 2 * BLOCK, 0] = 0.0
    disturbance = Disturbance(drop=0.5, duplicate=0.0, corrupt=0.0, late=0.5, lateness=30 * BLOCK)
    arrivals = arrivals_of(10.0, 0, 0, disturbance, Scripted([0] * 8 * BLOCK, fates))
    # the last sample of the first block is three blocks late, and the second block is lost
    now = START + 10 * (BLOCK - 2)
    newest = arrivals.newest(now)
    while arrivals.newest(now) == newest:
        now = arrivals.next_arrival(now)
    assert now == START + 10 * 2 * BLOCK


def test_samples_that_are_very_late_do_not_have_to_be_drawn_all_at_once() -> None:
    disturbance = Disturbance(0.0, 0.0, 0.0, late=1.0, lateness=10 * 100 * SAMPLES)
    arrivals = arrivals_of(10.0, 0, 0, disturbance, Scripted([0] * SAMPLES, np.full((SAMPLES, 4), 0.5)))
    assert START < arrivals.next_arrival(START) <= START + disturbance.lateness
    assert arrivals.newest(START) is None


@given(streams(), st.integers(0, 6 * BLOCK))
@settings(max_examples=30)
def test_what_was_doubled_and_overtaken_is_counted(stream: tuple[Arrivals, Plan, float], moment: int) -> None:
    arrivals, plan, period = stream
    now = START + round(moment * period)
    arrived = sorted(plan.arrived(now), key=lambda sample: (sample.arrival, sample.sequence))
    highest = [max(sample.sequence for sample in arrived[: place + 1]) for place in range(len(arrived))]
    counters = arrivals.counters(now)
    assert counters["samples_doubled"] == len(arrived) - len({sample.sequence for sample in arrived})
    assert counters["samples_overtaken"] == sum(
        sample.sequence < other for sample, other in zip(arrived, highest, strict=True)
    )


def test_nothing_is_counted_as_lost_where_nothing_is_dropped() -> None:
    late = Disturbance(0.0, 0.0, 0.0, late=0.2, lateness=55)
    arrivals = arrivals_of(10.0, 0, 0, late, np.random.default_rng(0))
    assert {arrivals.counters(START + now)["samples_lost"] for now in range(0, 2000, 5)} == {0}


def test_what_was_dropped_is_counted_as_lost() -> None:
    chances = np.full((SAMPLES, 4), 0.9)
    chances[[3, 4, 7], 0] = 0.0
    dropping = Disturbance(drop=0.5, duplicate=0.0, corrupt=0.0, late=0.0, lateness=0)
    arrivals = arrivals_of(10.0, 0, 0, dropping, Scripted([0] * SAMPLES, chances))
    assert arrivals.counters(START - 1)["samples_lost"] == 0
    assert arrivals.counters(START + 20)["samples_lost"] == 0
    assert arrivals.counters(START + 60)["samples_lost"] == 2
    assert arrivals.counters(START + 1000)["samples_lost"] == 3


def test_the_past_is_the_same_whatever_was_asked_before() -> None:
    disturbance = Disturbance(0.2, 0.1, 0.1, 0.2, 35)
    curious, patient = (arrivals_of(10.0, 3, 8, disturbance, np.random.default_rng(7)) for _ in range(2))
    patient.newest(START + 10 * SAMPLES)
    for now in range(START, START + 10 * BLOCK + 5000, 137):
        assert curious.newest(now) == patient.newest(now)
        assert curious.next_arrival(now) == patient.next_arrival(now)
