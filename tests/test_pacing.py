"""Pacing: deadlines on a grid, skipped or caught up after an overrun."""

from __future__ import annotations

import pytest
from helpers import run_joint
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Cost, Observation, Schedule, ms
from rtagent.instruments import Instrument
from rtagent.pacing import Pacer
from rtagent.schedule import Component, Overrun
from rtagent_drivers.stopping import stopping_joint

WORK = st.lists(st.integers(0, 50), min_size=1, max_size=30)


def run_paced(
    work: list[int], period: int, overrun: Overrun, start: int = 1000
) -> tuple[Pacer, list[int], list[int], list[int]]:
    """Pace cycles that take so long; return deadlines, when the cycles began, and when they ended."""
    pacer, now = Pacer(period, overrun, start), start
    deadlines, begun, ended = [], [], []
    for duration in work:
        deadlines.append(pacer.next(now))
        begun.append(max(now, deadlines[-1]))
        now = begun[-1] + duration
        ended.append(now)
    return pacer, deadlines, begun, ended


@given(WORK, st.integers(1, 20))
@settings(max_examples=200)
def test_with_skip_every_cycle_begins_on_the_grid(work: list[int], period: int) -> None:
    pacer, deadlines, begun, ended = run_paced(work, period, Overrun.SKIP)
    assert begun == deadlines
    assert all((deadline - 1000) % period == 0 for deadline in deadlines)
    # each cycle begins at the first deadline after the one before that is not yet past
    previous = [(1000, 1000), *zip(deadlines, ended, strict=True)]
    for (deadline, end), following in zip(previous, deadlines, strict=False):
        assert following == max(deadline + period, 1000 + -(-(end - 1000) // period) * period)
    assert pacer.skipped == (deadlines[-1] - 1000) // period - len(deadlines)


@given(WORK, st.integers(1, 20))
@settings(max_examples=200)
def test_with_catch_up_no_deadline_is_lost(work: list[int], period: int) -> None:
    pacer, deadlines, begun, ended = run_paced(work, period, Overrun.CATCH_UP)
    assert deadlines == [1000 + period * (number + 1) for number in range(len(work))]
    assert begun == [max(deadline, end) for deadline, end in zip(deadlines, [1000, *ended], strict=False)]
    assert pacer.skipped == 0


@given(WORK, st.integers(1, 20), st.sampled_from(Overrun))
@settings(max_examples=200)
def test_an_overrun_is_a_cycle_that_ends_after_the_next_deadline(
    work: list[int], period: int, overrun: Overrun
) -> None:
    pacer, deadlines, _, ended = run_paced(work, period, overrun)
    late = sum(end > deadline + period for deadline, end in zip(deadlines[:-1], ended, strict=False))
    assert pacer.overruns == late


class Looks(Instrument):
    """Notes when the agent looks and when it is done."""

    def __init__(self) -> None:
        self.began: list[int] = []
        self.looked: list[int] = []

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        self.began.append(time)

    def observed(self, observation: Observation, stimuli: object) -> None:
        self.looked.append(observation.time)


@pytest.mark.parametrize("period", [3 * ms, 7 * ms])
def test_a_paced_run_looks_at_the_world_once_every_period(period: int) -> None:
    looks = Looks()
    schedule = Schedule.preset("reactive", learn_delay=ms, period=period)
    result = run_joint(schedule, instruments=[looks])
    assert [time - looks.began[0] for time in looks.looked] == [n * period for n in range(len(looks.looked))]
    assert len(looks.looked) > 50
    assert result.recorder.counters["overruns"] == 0


def test_a_paced_run_skips_the_periods_that_its_learning_takes() -> None:
    looks = Looks()
    schedule = Schedule.preset("reactive", learn_delay=25 * ms, period=10 * ms)
    result = run_joint(schedule, instruments=[looks])
    apart = [second - first for first, second in zip(looks.looked, looks.looked[1:], strict=False)]
    # nothing is learned in the first cycle; all others overrun two deadlines
    assert apart == [10 * ms] + [30 * ms] * (len(apart) - 1)
    assert result.recorder.counters["skipped_periods"] == 2 * result.recorder.counters["overruns"] > 0


def test_what_comes_before_the_first_cycle_is_no_overrun() -> None:
    schedule = Schedule.preset("standard", learn_delay=ms, period=20 * ms)
    result = run_joint(schedule, episodes=3, costs={Component.OBSERVE: Cost(2 * ms)})
    assert result.recorder.counters["overruns"] == 0


def test_an_easy_pace_is_kept_from_the_first_cycle_under_the_real_clock() -> None:
    schedule = Schedule.preset("reactive", period=100 * ms)
    result = run_joint(schedule, joint=stopping_joint(onset=(0, ms)), clock_name="real")
    assert result.recorder.counters["overruns"] == 0


def test_a_schedule_is_not_paced_unless_it_says_so() -> None:
    assert Schedule.preset("reactive").period == 0
