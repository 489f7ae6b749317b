"""`rtagent bench`: what it keeps, what it compares, and what it refuses to."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS
from scipy.stats import trim_mean

from rtagent import ms
from rtagent.__main__ import main
from rtagent.errors import BaselineError, SpecError, UndecidedError
from rtagent.latencies import Counts, Rules
from rtagent.latencies.baseline import read, write
from rtagent.latencies.changes import Compared, Verdict, of_exact
from rtagent.latencies.comparing import refusal, with_stored
from rtagent.latencies.comparison import Quantiles, to_stored
from rtagent.latencies.figures import Exact, Figures, unmeasured
from rtagent.latencies.fixture import Latency
from rtagent.latencies.machine import machine, software

STOPPING = str(SCENARIOS / "stopping.toml")
RULES = Rules()


def figures(*keys: str, medians: float = 1000.0, rounds: int = 8, reactions: int = 20) -> Figures:
    """Return figures of the stopping task in which every median is about so long (ns)."""
    spread = np.geomspace(0.97, 1.03, rounds)
    values = {"reaction": (100 * medians * spread).tolist(), "choose": (medians * spread).tolist()}
    times = Quantiles(values, {"reaction": reactions, "choose": 500})
    counts = {"allocations": Counts("allocations", "stopping", {"choose: a": 2, "observe: b": 1})}
    return replace(unmeasured(STOPPING, keys), times=times, exact=Exact([5 * ms, 7 * ms], counts), reactions=[1, 2])


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    path = tmp_path / "base.json"
    write(path, [figures()])
    return path


def changed(path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    return path


def verdicts(compared: Compared) -> dict[str, Verdict]:
    return {change.what: change.verdict for change in compared.changes if change.verdict is not Verdict.SAME}


# Baselines


def test_a_baseline_is_read_as_it_was_written(stored: Path) -> None:
    found = read(stored)
    (kept,) = found.scenarios.values()
    assert kept == figures()
    assert (found.machine, found.software) == (machine(), software())
    assert not refusal(found)
    assert list(stored.parent.iterdir()) == [stored], "no half of it is left"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda data: data.update(version=2), "of version 2 of the format, and this rtagent reads version 1"),
        (lambda data: data.update(format="else"), "is no baseline: give a file that `rtagent bench --save`"),
        (lambda data: data.pop("scenarios"), r"is damaged \('scenarios'\)"),
        (lambda data: data["scenarios"]["stopping"].pop("times"), None),
        (lambda data: data["scenarios"]["stopping"].update(times=3), "is damaged"),
        (lambda data: data["scenarios"]["stopping"]["scenario"]["run"].update(seed=9), "the digest of stopping"),
    ],
)
def test_a_file_that_is_no_baseline_is_told(
    change: Callable[[dict[str, Any]], object], sentence: str | None, stored: Path
) -> None:
    changed(stored, change)
    if sentence is None:
        assert not read(stored).scenarios["stopping"].times.values
        return
    with pytest.raises(BaselineError, match=sentence):
        read(stored)


@pytest.mark.parametrize(
    ("text", "sentence"), [(None, "No such file"), ("[]", "is no baseline"), ("{", "this is not JSON")]
)
def test_what_cannot_be_read_is_told(text: str | None, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BaselineError, match=sentence):
        read(path)


def test_another_scenario_is_told_by_the_settings_that_differ(stored: Path) -> None:
    found = read(stored)
    with pytest.raises(BaselineError, match=r"another scenario of the name stopping: run\.seed was 1 and is 2\."):
        found.of(figures("run.seed=2"))
    with pytest.raises(BaselineError, match=r"has no figures of stoping: did you mean 'stopping'\?"):
        found.of(figures("name=stoping"))


def test_times_of_another_machine_are_not_compared_but_counts_are(stored: Path) -> None:
    found = read(changed(stored, lambda data: data["machine"].update(processor="Abacus")))
    counts = {"allocations": Counts("allocations", "", {"new": 1})}
    now = replace(figures(medians=9000.0), exact=Exact([5 * ms, 7 * ms], counts))
    compared = with_stored(found, now, RULES)
    assert verdicts(compared) == {"allocations in new": Verdict.MORE}
    (note,) = compared.notes
    assert "measured on another machine (processor was Abacus and is" in note


def test_counts_of_other_software_are_not_compared_but_times_are(stored: Path) -> None:
    found = read(changed(stored, lambda data: data["software"].update(python="CPython 3.99")))
    compared = with_stored(found, figures(medians=9000.0), RULES)
    assert verdicts(compared) == {"reaction": Verdict.SLOWER, "choose": Verdict.SLOWER}
    assert "measured with other software (python was CPython 3.99 and is" in compared.notes[0]


def test_where_nothing_is_left_to_compare_it_is_refused(stored: Path) -> None:
    changed(stored, lambda data: data.update(machine={}, software={}))
    assert refusal(read(stored)).endswith("Nothing is left to compare: save a new baseline with --save.")
    assert main(["bench", "--compare", str(stored)]) == 2


# Comparing with what was stored


@pytest.mark.parametrize(
    ("times", "verdict"),
    [
        (0.3, Verdict.QUICKER),
        (1.0, Verdict.SAME),
        (1.9, Verdict.SAME),
        (2.02, Verdict.UNSURE),
        (2.5, Verdict.SLOWER),
    ],
)
def test_of_stored_times_twice_as_long_is_told(times: float, verdict: Verdict, stored: Path) -> None:
    compared = with_stored(read(stored), figures(medians=1000 * times), RULES)
    assert verdicts(compared).get("choose", Verdict.SAME) is verdict
    assert bool(compared.regressions) == (verdict is Verdict.SLOWER)
    assert bool(compared.undecided) == (verdict is Verdict.UNSURE)


def test_too_few_reactions_are_told_and_not_guessed_from(stored: Path) -> None:
    compared = with_stored(read(stored), figures(medians=9000.0, reactions=9), RULES)
    assert verdicts(compared) == {"choose": Verdict.SLOWER, "reaction": Verdict.TOO_FEW}
    (few,) = compared.undecided
    assert few.by == "only 9 in a round: run more episodes"
    assert "of reaction nothing can be said" in replace(compared, changes=[few]).said()


def test_a_machine_that_was_too_busy_leaves_counts_to_compare(stored: Path) -> None:
    now = replace(figures(), times=Quantiles({}, {}), busy="the machine was too busy to measure.")
    compared = with_stored(read(stored), now, RULES)
    assert verdicts(compared) == {"times": Verdict.UNSURE}
    assert any(change.what == "allocations in a cycle" for change in compared.changes)


@given(st.floats(0.2, 5.0), st.floats(0.01, 0.3), st.integers(5, 30))
@settings(max_examples=30)
def test_the_interval_of_two_sessions_holds_their_ratio(ratio: float, noise: float, rounds: int) -> None:
    rng = np.random.default_rng(1)
    sides = [
        Quantiles({"choose": (1000 * times * np.exp(rng.normal(0, noise, rounds))).tolist()}, {"choose": 99})
        for times in (1.0, ratio)
    ]
    found = to_stored("base", "now", sides[0], sides[1], RULES)["choose"]
    assert found.low <= found.ratio <= found.high
    logs = [np.log(side.values["choose"]) for side in sides]
    assert np.log(found.ratio) == pytest.approx(trim_mean(logs[1], 0.2) - trim_mean(logs[0], 0.2))
    error = np.sqrt(sum(each.var() / rounds for each in logs))
    assert np.log(found.high / found.low) == pytest.approx(2 * 1.96 * error, rel=0.5)


# Exactly


def exact(reactions: Sequence[int] = (), note: str = "", **counts: float) -> Exact:
    return Exact(list(reactions), {"system calls": Counts("system calls", "mine", counts, note)})


def test_a_call_that_was_added_is_told_by_name() -> None:
    changes = list(of_exact(exact(read=1.0), exact(read=1.0, fsync=0.5)))
    (added,) = [change for change in changes if change.verdict.regression]
    assert str(added) == "system calls in fsync: 0 before, 0.5 now, +0.5 a cycle"


def test_fewer_calls_are_no_regression() -> None:
    (total,) = of_exact(exact(read=2.0), exact(read=1.0))
    assert (total.before, total.now, total.verdict) == ("2", "1", Verdict.FEWER)


@pytest.mark.parametrize(
    ("before", "now", "found"),
    [
        ([5, 6, 7], [5, 6, 7], {}),
        ([5, 6, 7], [5, 6, 8], {"reaction, longest (virtual)": Verdict.SLOWER}),
        ([5, 6, 7], [5, 5, 7], {"reaction, median (virtual)": Verdict.QUICKER}),
        ([5, 6, 7], [5, 7], {"reactions (virtual)": Verdict.MISSED, "reaction, median (virtual)": Verdict.SLOWER}),
        ([5], [], {"reactions (virtual)": Verdict.MISSED}),
        ([], [], {}),
    ],
)
def test_reactions_under_the_virtual_clock_are_compared_to_the_nanosecond(
    before: list[int], now: list[int], found: dict[str, Verdict]
) -> None:
    changes = of_exact(Exact(before), Exact(now))
    assert {change.what: change.verdict for change in changes if change.verdict is not Verdict.SAME} == found


def test_what_was_counted_in_two_ways_is_not_compared(stored: Path) -> None:
    one, other = exact(read=1.0), exact(read=9.0, note="(reads and writes only)")
    found = read(stored)
    found = replace(found, scenarios={"stopping": replace(found.scenarios["stopping"], exact=one)})
    compared = with_stored(found, replace(figures(), exact=other), RULES)
    assert not compared.regressions
    (note,) = compared.notes
    assert note == "system calls were counted in two ways, and are not compared: all and (reads and writes only)."


# The fixture


def test_a_test_is_told_why_a_baseline_says_nothing(stored: Path) -> None:
    latency = Latency(RULES)
    with pytest.raises(SpecError, match="is no scenario under the real clock"):
        latency.to_baseline(STOPPING, stored, "run.clock=virtual")
    with pytest.raises(BaselineError, match=r"run\.seed was 1 and is 2"):
        latency.to_baseline(STOPPING, stored, "run.seed=2")
    changed(stored, lambda data: data["machine"].update(processor="Abacus"))
    with pytest.raises(UndecidedError, match="was measured on another machine"):
        latency.to_baseline(STOPPING, stored)
