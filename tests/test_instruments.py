"""Series, summaries and hooks: what a run writes down, and what cannot break it."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
import pytest
from helpers import run_joint
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Schedule, ms
from rtagent.instruments import HOOKS, Hooks, Instrument
from rtagent.recorder import MOST_FAULTS, EpisodeRecord, Fault, Recorder
from rtagent.series import Series
from rtagent.summary import Summary

INTEGERS = st.integers(-(2**62), 2**62)


@given(st.lists(INTEGERS, max_size=30), st.integers(1, 10))
@settings(max_examples=200)
def test_a_series_keeps_the_newest_and_knows_all(values: list[int], capacity: int) -> None:
    series = Series(capacity)
    for value in values:
        series.record(value)
    assert series.values() == values[-capacity:]
    assert series.count == len(values)
    assert series.maximum == max(values, default=0)


def test_a_series_takes_no_more_memory_when_it_is_written_to() -> None:
    series = Series(100)
    kept = series._values.buffer_info()
    for value in range(1000):
        series.record(value)
    assert series._values.buffer_info() == kept


@given(st.lists(st.integers(0, 10**12), min_size=1, max_size=50))
@settings(max_examples=100)
def test_a_summary_gives_the_quantiles(values: list[int]) -> None:
    summary = Summary.of(values, missed=2)
    assert summary.count == len(values)
    assert summary.maximum == max(values)
    assert summary.missed == 2
    assert min(values) <= summary.median <= summary.p90 <= summary.p99 <= summary.maximum
    below = sum(value <= summary.median for value in values)
    assert below >= len(values) / 2
    p90, p99 = np.quantile(values, [0.9, 0.99])
    assert summary.in_seconds() == pytest.approx(
        {
            "count": len(values),
            "median_s": float(np.median(values)) * 1e-9,
            "p90_s": p90 * 1e-9,
            "p99_s": p99 * 1e-9,
            "max_s": max(values) * 1e-9,
        }
    )


def test_a_summary_of_a_long_series_says_how_many_there_were() -> None:
    summary = Summary.of([1, 2, 3], count=1000, maximum=99)
    assert (summary.count, summary.maximum, summary.median) == (1000, 99, 2)


def test_a_summary_of_nothing_is_all_zero_but_for_what_was_missed() -> None:
    assert Summary.of([], missed=3) == Summary(0, 0, 0, 0, 0, 3)


class Notes:
    """An instrument that has some of the hooks and is no `Instrument`."""

    def __init__(self) -> None:
        self.got: list[object] = []

    def chose(self, action: int, probability: float, time: int) -> None:
        self.got.append((action, probability, time))

    def component(self, *args: object) -> None:
        self.got.append(args)


class Broken(Notes):
    """An instrument of which one hook raises."""

    def __init__(self, at: int = 1) -> None:
        super().__init__()
        self.calls, self.at = 0, at

    def chose(self, action: int, probability: float, time: int) -> None:
        self.calls += 1
        if self.calls >= self.at:
            raise ValueError("broken")


def test_every_hook_reaches_every_instrument_that_has_it() -> None:
    first, second = Notes(), Notes()
    hooks = Hooks([first, object(), second, Instrument()])
    hooks.call("chose", 1, 0.5, 7)
    hooks.call("reacted", None)
    hooks.call("component", "act", 1, 2)
    assert first.got == second.got == [(1, 0.5, 7), ("act", 1, 2)]
    assert hooks.heard


def test_instruments_may_come_from_a_generator() -> None:
    notes = Notes()
    hooks = Hooks(each for each in [notes])
    hooks.call("chose", 1, 0.5, 7)
    assert notes.got == [(1, 0.5, 7)]


@pytest.mark.parametrize("instruments", [[], [object()], [Instrument()], [type("Empty", (Instrument,), {})()]])
def test_without_hooks_there_is_nothing_to_call(instruments: Sequence[object]) -> None:
    assert not Hooks(instruments).heard


def test_a_hook_that_raises_is_removed_and_logged_and_the_others_go_on(caplog: pytest.LogCaptureFixture) -> None:
    before, broken, after = Notes(), Broken(at=2), Notes()
    hooks = Hooks([before, broken, after])
    with caplog.at_level(logging.ERROR, "rtagent"):
        for time in range(4):
            hooks.call("chose", 0, 1.0, time)
    hooks.call("component", "act", 1, 2)
    assert broken.calls == 2
    assert broken.got == [("act", 1, 2)]
    assert len(before.got) == len(after.got) == 5
    assert len(hooks.removed) == len(caplog.records) == 1
    assert "Broken raised ValueError('broken') in its hook 'chose'" in hooks.removed[0]


def test_two_hooks_that_raise_in_one_call_are_both_removed(caplog: pytest.LogCaptureFixture) -> None:
    first, second = Broken(), Broken()
    hooks = Hooks([first, second])
    for time in range(3):
        hooks.call("chose", 0, 1.0, time)
    assert (first.calls, second.calls, len(hooks.removed)) == (1, 1, 2)
    assert len(caplog.records) == 2


def test_a_hook_that_is_no_function_is_removed_like_one_that_raises(caplog: pytest.LogCaptureFixture) -> None:
    class Odd:
        chose = 3

    hooks = Hooks([Odd()])
    hooks.call("chose", 0, 1.0, 0)
    hooks.call("chose", 0, 1.0, 0)
    assert len(hooks.removed) == len(caplog.records) == 1


class Everything(Instrument):
    """Notes the names of the hooks that were called."""

    def __init__(self) -> None:
        self.called: list[str] = []

    def __getattribute__(self, name: str) -> object:
        if name in HOOKS:
            return lambda *_: self.called.append(name)
        return super().__getattribute__(name)


def test_a_run_calls_its_hooks_in_the_order_of_what_happens() -> None:
    everything = Everything()
    result = run_joint(Schedule.preset("reactive", learn_delay=10 * ms), episodes=2, instruments=[everything])
    called = everything.called
    assert called[:4] == ["run_began", "counting_began", "trial_began", "episode_began"]
    assert called[-2:] == ["episode_ended", "trial_ended"]
    assert called.count("episode_began") == called.count("episode_ended") == 2
    assert called.count("learned") == sum(episode.steps for episode in result.episodes)
    assert called.count("reacted") == len(result.reaction_times) > 0
    assert called.count("component") == sum(
        called.count(name) for name in ("observed", "chose", "acted", "learned")
    )
    assert set(called) == set(HOOKS) - {"fault", "learned_for"}


def test_an_instrument_that_raises_in_every_hook_changes_nothing_in_a_run(caplog: pytest.LogCaptureFixture) -> None:
    class Sabotage(Everything):
        def __getattribute__(self, name: str) -> object:
            if name in HOOKS:
                return lambda *_: 1 / 0
            return super().__getattribute__(name)

    schedule = Schedule.preset("reactive", learn_delay=10 * ms)
    plain, sabotaged = run_joint(schedule, episodes=2), run_joint(schedule, episodes=2, instruments=[Sabotage()])
    assert sabotaged.reaction_times == plain.reaction_times
    assert [each.total_reward for each in sabotaged.episodes] == [each.total_reward for each in plain.episodes]
    assert sabotaged.recorder.counters["instruments_removed"] > 0
    assert caplog.records


def test_an_episode_lasts_from_its_beginning_to_its_end() -> None:
    assert EpisodeRecord(0, 0, began=100, ended=350).duration == 250


def test_a_fault_that_comes_again_is_counted_and_not_listed_again() -> None:
    recorder = Recorder()
    for time in range(5):
        recorder.fault(Fault(time, "arm", "it hangs"))
    recorder.fault(Fault(9, "leg", "it hangs"))
    assert [(fault.time, fault.source, fault.count) for fault in recorder.faults] == [(0, "arm", 5), (9, "leg", 1)]


def test_faults_are_listed_up_to_a_limit_but_what_ends_a_run_always() -> None:
    recorder = Recorder()
    for number in range(MOST_FAULTS + 7):
        recorder.fault(Fault(number, "arm", f"number {number}"))
    recorder.fault(Fault(999, "arm", "the end", fatal=True))
    assert len(recorder.faults) == MOST_FAULTS + 1
    assert recorder.faults[-1].fatal
    assert recorder.counters["faults_not_listed"] == 7
