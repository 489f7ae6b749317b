"""Latency as a test: what the plugin for pytest catches, and what it says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import ROOT, SCENARIOS
from reacting import reacting

from rtagent import ms, us
from rtagent.errors import ClockError, ScenarioError, SpecError, UndecidedError
from rtagent.latencies import Counts, Measured, Rules, Subject, Times
from rtagent.latencies import rounds as rounds_of
from rtagent.latencies import system_calls as calling
from rtagent.latencies.comparison import compare, compared, to_floor
from rtagent.latencies.fixture import Latency
from rtagent.latencies.host import Disturbance, bound_to, watched
from rtagent.latencies.rounds import Measure, Round, Rounds, interleaved
from rtagent.pytest_plugin import MARKER, OPTION, STRICT

pytestmark = pytest.mark.slow

pytest_plugins = "pytester"

STOPPING = str(SCENARIOS / "stopping.toml")
VIRTUAL = ("run.clock=virtual", "run.episodes=4")


@pytest.fixture
def tests(pytester: pytest.Pytester) -> pytest.Pytester:
    """Tests in a folder of their own, which know where the scenario is."""
    pytester.makeini("[pytest]\nasyncio_default_fixture_loop_scope = function\n")
    return pytester


def outcome(tests: pytest.Pytester, body: str, *arguments: str, marker: str = "") -> tuple[str, dict[str, int]]:
    """Run one test with this body; return what is printed, and the outcomes."""
    head = f"import pytest\nfrom rtagent import ms, us\nSTOPPING = {STOPPING!r}\nVIRTUAL = {VIRTUAL!r}\n"
    lines = "\n".join(f"    {line}" for line in body.strip().splitlines())
    tests.makepyfile(f"{head}{marker}\ndef test_it(rtagent_latency):\n{lines}\n")
    result = tests.runpytest_inprocess("-p", "no:cacheprovider", "-rs", *arguments)
    return str(result.stdout), {key: n for key, n in result.parseoutcomes().items() if key != "warnings"}


# Under the virtual clock: exactly


def test_a_reaction_within_delay_and_costs_passes(tests: pytest.Pytester) -> None:
    body = """
measured = rtagent_latency.run(STOPPING, *VIRTUAL, "costs.choose=2ms", "costs.act=1ms")
costs = 2 * ms + 1 * ms  # those of the cycle in which it happens, and of the one that reacts
measured.assert_at_most(50 * ms + 2 * costs, least=4)
assert 53 * ms < measured.reaction.maximum <= 50 * ms + 2 * costs
assert measured["choose"].maximum == 2 * ms
"""
    printed, outcomes = outcome(tests, body)
    assert outcomes == {"passed": 1}, printed


def test_a_slowdown_is_caught_with_the_component_that_takes_longest(tests: pytest.Pytester) -> None:
    body = 'rtagent_latency.run(STOPPING, *VIRTUAL, "schedule.learn_delay=80ms").assert_at_most(50 * ms)'
    printed, outcomes = outcome(tests, body)
    assert outcomes == {"failed": 1}
    assert "times of reaction are longer than 50 ms; the longest is" in printed
    assert "Its parts: sensing" in printed
    assert "The component that took longest is learn: up to 80 ms at a time." in printed


@pytest.mark.parametrize("component", ["choose", "act", "observe", "learn"])
def test_the_component_that_got_slower_is_named_first(component: str) -> None:
    costs = [f"costs.{each}={'5ms'}" for each in ("choose", "act", "observe", "learn")]
    before = Subject.scenario(STOPPING, *VIRTUAL, *costs).called("main")
    after = Subject.scenario(STOPPING, *VIRTUAL, *costs, f"costs.{component}=6ms").called("mine")
    with pytest.raises(AssertionError) as caught:
        compare(before, after, Rules()).assert_at_most(1.01)
    first, second, *_, last = str(caught.value).splitlines()
    assert first == f"mine is slower than 1.01 × main, in {component} above all."
    assert second.strip().startswith(f"{component}: 1.")
    assert last == "Exact: measured under the virtual clock."
    compare(before, before, Rules()).assert_at_most(1.0)


def test_what_cost_nothing_before_is_infinitely_slower() -> None:
    before = Subject.scenario(STOPPING, *VIRTUAL)
    after = Subject.scenario(STOPPING, *VIRTUAL, "costs.choose=1us")
    ratio = compare(before, after, Rules())["choose"]
    assert (ratio.ratio, ratio.before, ratio.after) == (np.inf, 0, 1 * us)


def test_a_stimulus_without_any_reaction_is_later_than_any_limit() -> None:
    late = Subject.scenario(STOPPING, *VIRTUAL, "run.episode_time=600ms", "schedule.learn_delay=500ms")
    measured = Measured(late.run(), "mine")
    missed = measured.result.reaction_time.missed
    assert missed > 0
    with pytest.raises(AssertionError, match=f"mine: {missed} stimuli had no reaction"):
        measured.assert_at_most(10**12)
    with pytest.raises(UndecidedError, match="mine has 0 times of reaction"):
        measured.assert_at_most(10**12, missed=missed)


# Exact counts


def test_allocations_are_the_same_in_every_run_and_an_added_one_fails_by_name(
    tests: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rtagent.latencies.allocations.SKIPPED", 12)
    monkeypatch.setattr("rtagent.latencies.allocations.COUNTED", 3)
    body = """
from rtagent.tasks import Stopping

before = rtagent_latency.allocations(STOPPING, *VIRTUAL)
rtagent_latency.allocations(STOPPING, *VIRTUAL).assert_no_more_than(before)
before.assert_at_most(before.total)
interpret = Stopping.interpret

def wasteful(self, observation):
    waste = object()
    return interpret(self, observation)

Stopping.interpret = wasteful
try:
    rtagent_latency.allocations(STOPPING, *VIRTUAL).assert_no_more_than(before)
finally:
    Stopping.interpret = interpret
"""
    printed, outcomes = outcome(tests, body)
    assert outcomes == {"failed": 1}
    assert "has more allocations in a cycle than before" in printed
    assert re.search(r"test_it.<locals>.wasteful: \d, and 0 before", printed)
    assert printed.count(" before\n") == 1, "nothing else is accused"


def test_system_calls_are_read_from_the_table_of_strace() -> None:
    table = """% time     seconds  usecs/call     calls    errors syscall
------ ----------- ----------- --------- --------- ----------------
 60.00    0.000064           2        29         1 openat
 40.00    0.000010           0       130           read
------ ----------- ----------- --------- --------- ----------------
100.00    0.000074           2       159         1 total
"""
    assert calling._table(table) == {"openat": 29, "read": 130}


def test_an_added_call_a_cycle_is_found_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def counted(subject: Subject) -> tuple[Mapping[str, int], int]:
        cycles = 100 if "run.episodes=20" in subject.overrides else 200
        return {"openat": 400, "write": 3 * cycles, "fsync": cycles // 100, "brk": cycles // 50}, cycles

    monkeypatch.setattr(calling, "_measure", lambda: (counted, ""))
    counts = calling.system_calls(Subject.scenario(STOPPING, *VIRTUAL))
    assert counts.per_cycle == {"write": 3.0, "fsync": 0.01}
    with pytest.raises(AssertionError, match=r"3.01 system calls in a cycle, and 2 are allowed:\n  write: 3"):
        counts.assert_at_most(2)


def test_without_strace_the_kernel_counts_reads_and_writes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calling, "_may_trace", lambda: False)
    counts = calling.system_calls(Subject.scenario(STOPPING, *VIRTUAL), episodes=1)
    assert counts.total == 0
    with pytest.raises(AssertionError, match="only reads and writes were counted"):
        counts.assert_at_most(-1)
    monkeypatch.setattr(calling, "IO", Path("/nowhere"))
    with pytest.raises(SpecError, match="install strace"):
        calling.system_calls(Subject.scenario(STOPPING, *VIRTUAL))


def test_counts_name_what_grew_and_not_what_shrank() -> None:
    counts = Counts("allocations", "mine", {"a": 2, "b": 5})
    with pytest.raises(AssertionError) as caught:
        counts.assert_no_more_than({"a": 1, "b": 6})
    assert str(caught.value) == "mine has more allocations in a cycle than before:\n  a: 2, and 1 before"


# Statistics


def rounds(logs: Sequence[float], count: int = 20, name: str = "reaction") -> Rounds:
    """Return rounds in which the second takes exp(log) times as long."""
    blocks = [[{name: [1000] * count}, {name: [round(1000 * np.exp(log))] * count}] for log in logs]
    return Rounds([Round(block, 0.0) for block in blocks])


def test_an_interval_holds_the_true_ratio_about_as_often_as_it_says() -> None:
    rng, held = np.random.default_rng(1), 0
    for _ in range(100):
        noisy = rounds(rng.normal(np.log(1.2), 0.1, size=12), count=10)
        ratio = compared("before", "after", noisy, Rules(), 0.5)["reaction"]
        held += ratio.low <= 1.2 <= ratio.high
    assert 82 <= held <= 99


@given(st.floats(0.5, 2.0), st.floats(1.01, 1.5))
@settings(max_examples=25)
def test_what_is_the_same_in_every_round_is_told_exactly(true: float, by: float) -> None:
    found = compared("before", "after", rounds([np.log(true)] * 6), Rules(), 0.5)
    assert found["reaction"].low == pytest.approx(true, abs=1e-3)
    found.assert_at_most(true * by)
    with pytest.raises(AssertionError):
        found.assert_at_most(true / by)


def test_a_round_that_was_disturbed_decides_nothing() -> None:
    found = compared(
        "before", "after", rounds([0.01, -0.02, 2.0, 0.0, 0.02, -0.01, 0.01, -1.0, 0.02, -0.02]), Rules()
    )
    assert found["reaction"].ratio == pytest.approx(1.0, abs=0.02)
    found.assert_at_most(1.1)


def test_what_is_not_sure_is_undecided_and_not_failed() -> None:
    noisy = compared("before", "after", rounds([0.4, -0.3, 0.5, -0.2, 0.3, 0.1]), Rules(), 0.5)
    noisy.assert_at_most(1.3)
    with pytest.raises(UndecidedError, match=r"it is not sure that after keeps to 1.05 × before: reaction: 1.1"):
        noisy.assert_at_most(1.05)


def test_too_few_reactions_in_a_round_are_told() -> None:
    few = compared("before", "after", rounds([0.5] * 6, count=9), Rules(), 0.5)
    with pytest.raises(UndecidedError, match="only 9 times of reaction, which say too little"):
        few.assert_at_most(1.2)
    assert any("too few to compare: reaction (9)" in line for line in few.lines())
    with pytest.raises(UndecidedError, match="only 0 times of choose"):
        compared("before", "after", rounds([0.5] * 6, count=0, name="choose"), Rules())["choose"]
    tail = compared("before", "after", rounds([0.5] * 6, count=50), Rules(), 0.99)
    with pytest.raises(UndecidedError, match="only 50 times"):
        tail["reaction"]


@pytest.mark.parametrize(
    ("count", "q", "enough"), [(99, 0.99, False), (100, 0.99, True), (1, 0.5, False), (2, 0.5, True)]
)
def test_a_quantile_needs_a_time_beyond_it(count: int, q: float, enough: bool) -> None:
    times = Times("reaction", [5] * count)
    if enough:
        assert times.quantile(q) == 5
    else:
        with pytest.raises(UndecidedError, match=f"has {count} times of reaction"):
            times.quantile(q)


def test_no_times_have_no_maximum() -> None:
    with pytest.raises(UndecidedError, match="has 0 times of act, and a maximum needs 1"):
        _ = Times("act", []).maximum


# The host


def test_rounds_take_turns_and_those_that_others_disturbed_are_set_aside(monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    lost = iter([0.0] * 2 + [0.0, 0.5] * 2 + [0.01] * 10)

    class Watch:
        def __enter__(self) -> Disturbance:
            return Disturbance(1000, round(1000 * next(lost)), 0)

        def __exit__(self, *exception: object) -> None: ...

    monkeypatch.setattr(rounds_of, "watched", lambda *_: Watch())
    measures = [Measure(lambda name=name: order.append(name) or {"reaction": [1]}) for name in "ab"]  # type: ignore[misc,func-returns-value]
    found = interleaved(measures, Rules(rounds=7, warm_up=1))
    assert "".join(order) == "ab" + "abba" * 3 + "ab"
    assert (len(found.kept), found.set_aside, found.most_lost) == (5, 2, 0.5)
    assert found.said() == "5 rounds, interleaved; 2 were set aside, in which others had the processor."


def test_a_machine_that_is_too_busy_is_told_apart_from_a_slow_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rounds_of.Disturbance, "share", 0.4)
    with pytest.raises(UndecidedError, match=r"too busy to measure: in 6 of 6 rounds others had the processor"):
        interleaved([Measure(lambda: {"reaction": [1]})], Rules(rounds=6))


def test_time_that_others_had_the_processor_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stat, schedstat = tmp_path / "stat", tmp_path / "schedstat"
    monkeypatch.setattr("rtagent.latencies.host.STAT", stat)
    monkeypatch.setattr("rtagent.latencies.host.SCHEDSTAT", schedstat)

    def kernel_says(steal: int, waited: int) -> None:
        stat.write_text(f"cpu 1 2 3 4 5 6 7 999 0 0\ncpu1 1 2 3 4 5 6 7 {steal} 0 0\n")
        schedstat.write_text(f"100 {waited} 7\n")

    kernel_says(10, 1000)
    with watched(1) as found:
        kernel_says(13, 1500)
    assert (found.stolen, found.waited) == (30 * ms, 500)
    assert found.lasted > 0
    stat.unlink()
    schedstat.unlink()
    with watched(1) as unknown:
        pass
    assert unknown.share == 0


def test_measuring_is_bound_to_one_processor_and_gives_it_back() -> None:
    import os

    before = os.sched_getaffinity(0)
    with bound_to(None) as processor:
        assert os.sched_getaffinity(0) == {processor} == {max(before)}
    assert os.sched_getaffinity(0) == before
    with pytest.raises(SpecError, match="processor 999 is not for us"), bound_to(999):
        pass


# Bad use, each with its sentence

BAD_USE = {
    "under the real clock: mark it with @pytest.mark.rtagent_latency": "rtagent_latency.run(STOPPING)",
    "no times of 'reacton': did you mean 'reaction'?": 'rtagent_latency.run(STOPPING, *VIRTUAL)["reacton"]',
    "there is no key 'schedule.pre'": 'rtagent_latency.run(STOPPING, "schedule.pre=1")',
    "3 cannot be measured: give the path of a scenario": "rtagent_latency.run(3)",
    "the clock 'moon' is none: use 'real' or 'virtual'": 'rtagent_latency.of(print, "moon")',
    "runs under the virtual clock, which has no floor": "rtagent_latency.to_floor(STOPPING, *VIRTUAL)",
    "the limit 0 is no ratio": (
        "v = rtagent_latency.scenario(STOPPING, *VIRTUAL)\nrtagent_latency.compare(v, v).assert_at_most(0)"
    ),
    "nothing was compared that is called 'lern': did you mean 'learn'?": (
        'v = rtagent_latency.scenario(STOPPING, *VIRTUAL)\nrtagent_latency.compare(v, v).assert_at_most(2, "lern")'
    ),
    "the quantile 99 is not between 0 and 1": "rtagent_latency.run(STOPPING, *VIRTUAL).reaction.quantile(99)",
    "is no scenario, and this needs one": 'rtagent_latency.system_calls(rtagent_latency.of(print, "virtual"))',
    "episodes is 1 or more": "rtagent_latency.system_calls(STOPPING, *VIRTUAL, episodes=0)",
}


@pytest.mark.parametrize("sentence", BAD_USE)
def test_bad_use_is_told_in_a_sentence(sentence: str, tests: pytest.Pytester) -> None:
    printed, outcomes = outcome(tests, BAD_USE[sentence])
    assert outcomes == {"failed": 1}
    assert sentence in printed


BAD_MARKS = {
    "rounds=2 are too few for an interval": "rounds=2",
    "the marker rtagent_latency knows no 'runds': did you mean 'rounds'?": "runds=9",
    "takes names only, such as rounds=20: it got 5": "5",
    "confidence=95 is no confidence": "confidence=95",
    "stolen=0 is no share": "stolen=0",
    "warm_up is 0 or more": "warm_up=-1",
}


@pytest.mark.parametrize("sentence", BAD_MARKS)
def test_a_bad_marker_is_told_in_a_sentence(sentence: str, tests: pytest.Pytester) -> None:
    printed, outcomes = outcome(tests, "pass", OPTION, marker=f"@pytest.mark.{MARKER}({BAD_MARKS[sentence]})")
    assert outcomes == {"errors": 1}
    assert sentence in printed


def test_clocks_are_not_mixed() -> None:
    real, virtual = Subject.scenario(STOPPING), Subject.scenario(STOPPING, *VIRTUAL)
    with pytest.raises(SpecError, match=r"runs under the real clock and .* does not: use one clock"):
        compare(real, virtual, Rules())
    with pytest.raises(SpecError, match="allocations are counted under the virtual one"):
        Latency().allocations(real)


async def test_a_test_that_is_async_is_told_not_to_be() -> None:
    for subject in (Subject.scenario(STOPPING, *VIRTUAL), Subject.of(reacting(0), "virtual")):
        with pytest.raises(ClockError, match="measure in a test that is not async"):
            subject.run()


def test_several_processes_of_xdist_do_not_measure(tests: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw0")
    printed, outcomes = outcome(tests, "rtagent_latency.run(STOPPING)", OPTION, marker=f"@pytest.mark.{MARKER}")
    assert outcomes == {"failed": 1}
    assert "pytest-xdist runs several: run with -n0" in printed


def test_a_bad_scenario_has_all_its_problems_told() -> None:
    with pytest.raises(ScenarioError):
        Latency().scenario("nowhere.toml")


# Options


def test_real_measurements_are_skipped_unless_asked_for(tests: pytest.Pytester) -> None:
    printed, outcomes = outcome(tests, "assert False", marker=f"@pytest.mark.{MARKER}")
    assert outcomes == {"skipped": 1}
    assert f"measures in real time: run with {OPTION}" in printed


@pytest.mark.parametrize(("options", "result"), [((), "skipped"), ((STRICT,), "failed")])
def test_what_is_undecided_is_said(options: tuple[str, ...], result: str, tests: pytest.Pytester) -> None:
    body = "rtagent_latency.run(STOPPING, *VIRTUAL).assert_at_most(10**9, least=1000)"
    printed, outcomes = outcome(tests, body, *options)
    assert outcomes == {result: 1}
    assert "has 4 times of reaction, and a limit of 1 s needs 1000: run more episodes" in printed


def test_what_was_measured_is_in_the_summary(tests: pytest.Pytester) -> None:
    body = "v = rtagent_latency.scenario(STOPPING, *VIRTUAL)\nrtagent_latency.compare(v, v)"
    printed, outcomes = outcome(tests, body)
    assert outcomes == {"passed": 1}
    assert "= rtagent latency =" in printed
    assert "  learn: 1 ×, 50 ms against 50 ms" in printed


# Under the real clock


def test_the_tests_of_the_page_pass(tests: pytest.Pytester) -> None:
    (page,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "latency.md").read_text(), re.DOTALL)
    tests.makepyfile(page.replace("scenarios/stopping.toml", STOPPING))
    result = tests.runpytest_inprocess("-p", "no:cacheprovider", OPTION)
    outcomes = result.parseoutcomes()
    assert outcomes.get("failed", 0) == outcomes.get("errors", 0) == 0, str(result.stdout)
    assert outcomes["passed"] >= 2, "on a machine that is very busy, what is measured in real time is undecided"


def test_a_seeded_slowdown_is_caught_in_real_time_and_none_is_not() -> None:
    latency = Latency(Rules(rounds=10, stolen=1.0, least=3))
    before, same = (latency.of(reacting(200 * us), "real", name) for name in ("main", "same"))
    slow = latency.of(reacting(400 * us), "real", "mine")
    with pytest.raises(AssertionError, match=r"mine is slower than 1.2 × main, in choose above all.\n  choose: "):
        latency.compare(before, slow).assert_at_most(1.2, "choose", "deciding")
    latency.compare(before, same).assert_at_most(1.5, "choose")


def test_reactions_arecompared_with_bare_wake_ups() -> None:
    found = to_floor(Subject.of(reacting(1 * ms), "real"), Rules(rounds=5, stolen=1.0))
    assert found["choose"].ratio > 1
    assert found["choose"].after > 1 * ms > found["choose"].before
    with pytest.raises(AssertionError, match=r"is slower than 0.5 × a bare wake-up"):
        found.assert_at_most(0.5, "choose")


def test_system_calls_of_real_cycles_are_counted_by_name() -> None:
    keys = ("schedule.learn_delay=0s", "schedule.period=20ms", "run.seed=1")
    counts = Latency().system_calls(STOPPING, *keys, episodes=1)
    assert sum(count for name, count in counts.per_cycle.items() if "epoll" in name or "select" in name) >= 0.9
