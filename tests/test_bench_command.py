"""The command `rtagent bench`, what it shows, and the processes in which it measures other revisions."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import ROOT, SCENARIOS

from rtagent import ms
from rtagent.__main__ import main
from rtagent.commands.bench_plot import draw
from rtagent.commands.bench_report import BAR_WIDTH, BINS, as_markdown, two_histograms
from rtagent.errors import BaselineError
from rtagent.latencies import Rules
from rtagent.latencies.baseline import read
from rtagent.latencies.changes import Change, Compared, Verdict
from rtagent.latencies.comparison import Ratio
from rtagent.latencies.comparison import Verdict as Kept
from rtagent.latencies.fixture import Latency
from rtagent.latencies.processes import beside, workers
from rtagent.latencies.revision import installed

STOPPING = str(SCENARIOS / "stopping.toml")


def changed(path: Path, change: Callable[[Any], object]) -> None:
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


# What is shown


def compared_with(*changes: Change, reactions: tuple[list[int], list[int]] = ([], [])) -> Compared:
    return Compared("stopping", "base.json", 2.0, changes, ("a note",), reactions)


RATIO = Ratio("choose", 3, 2.8, 3.2, 1000, 3000)
SLOWER = Change("choose", "1 µs", "3 µs", RATIO.said(), Verdict.SLOWER, RATIO)


def test_the_summary_for_a_pull_request_is_a_table_of_markdown() -> None:
    lines = as_markdown([compared_with(SLOWER)]).splitlines()
    assert lines[0] == "### stopping, compared with base.json"
    assert lines[2] == "1 got worse: choose: 1 µs before, 3 µs now, 3 × (2.8 to 3.2)."
    assert "| choose | 1 µs | 3 µs | 3 × (2.8 to 3.2) | **slower** |" in lines
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1
    assert "- a note" in lines


@given(st.lists(st.integers(0, 10**9), min_size=1), st.lists(st.integers(0, 10**9), min_size=1))
@settings(max_examples=30)
def test_two_histograms_have_one_scale_and_nothing_is_wider(before: list[int], now: list[int]) -> None:
    lines = two_histograms(before, now)
    bars = [line.count(mark) for line in lines for mark in "░█" if mark in line]
    assert max(bars) == BAR_WIDTH
    assert len(lines) == 2 * BINS


@pytest.mark.slow  # matplotlib takes its time
def test_a_picture_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="it is an optional package")
    path = tmp_path / "bench.svg"
    draw([compared_with(SLOWER, reactions=([1 * ms, 2 * ms], [3 * ms])), compared_with()], path)
    assert path.read_text().count("stopping, compared with base.json") >= 1


# The command


@pytest.fixture
def no_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Count nothing: it is slow, and looked at elsewhere."""
    monkeypatch.setattr("rtagent.latencies.figures.COUNTED", {})


BENCH = ("bench", STOPPING, "--set", "run.clock=virtual", "--episodes", "3")


@pytest.mark.usefixtures("no_counts")
def test_a_baseline_is_kept_and_compared_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base, markdown = tmp_path / "base.json", tmp_path / "bench.md"
    assert main([*BENCH, "--save", str(base)]) == 0
    assert main(["bench", "--compare", str(base), "--markdown", str(markdown)]) == 0
    assert "No regression" in capsys.readouterr().out
    changed(base, lambda data: data["scenarios"]["stopping"]["exact"].update(reactions=[1, 2, 3]))
    assert main(["bench", "--compare", str(base), "--markdown", str(markdown)]) == 1
    assert "got worse: reaction, median (virtual): 2 ns before" in capsys.readouterr().out
    assert "**slower**" in markdown.read_text()


@pytest.mark.usefixtures("no_counts")
def test_what_is_undecided_fails_where_that_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = tmp_path / "base.json"
    assert main([*BENCH, "--save", str(base)]) == 0
    unsure = Change("choose", "", "", "", Verdict.UNSURE)
    monkeypatch.setattr("rtagent.commands.bench.with_stored", lambda *_: compared_with(unsure))
    assert main(["bench", "--compare", str(base)]) == 0
    assert main(["bench", "--compare", str(base), "--strict"]) == 1


@pytest.mark.usefixtures("no_counts")
def test_half_a_baseline_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "rtagent.commands.bench.measured", lambda figures, *_: replace(figures, busy="it was too busy.")
    )
    base = tmp_path / "base.json"
    assert main([*BENCH, "--save", str(base)]) == 1
    assert not base.exists()
    assert "base.json was not written: it was too busy." in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "there is nothing to do: give a scenario to measure"),
        (["--save", "nowhere/base.json"], "--save nowhere/base.json: give a file in a folder that exists."),
        (["x.toml", "--compare", "nowhere.json"], "nowhere.json: No such file"),
        (["nowhere.toml"], "nowhere.toml"),
        (["--floor", "--against", "main"], "--floor and --against do not go together."),
        (["--against", "main", "--save", "x.json"], "--against do not go together with --save."),
        ([STOPPING, "--plot", "x.png"], "--plot and --markdown show a comparison"),
        (["--compare", "x.json", "--save", "x.json"], "x.json would be lost: save to another file."),
        ([STOPPING, "--rounds", "3"], "rounds=3 are too few for an interval"),
        ([STOPPING, "--limit", "0.5"], "--limit 0.5 is below 1"),
        ([STOPPING, "--stolen", "2"], "stolen=2.0 is no share"),
        ([STOPPING, STOPPING], "two scenarios are called 'stopping'"),
    ],
)
def test_bad_use_is_told_before_anything_is_measured(
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("rtagent.commands.bench.measured", lambda *_: pytest.fail("something was measured"))
    assert main(["bench", *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_without_matplotlib_a_picture_is_refused_beforehand(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["bench", "--compare", "base.json", "--plot", "bench.png"]) == 2
    assert "--plot needs matplotlib: pip install 'rtagent[figures]'." in capsys.readouterr().err


# Processes, and other revisions


SHARE = "rtagent.latencies.rounds.Disturbance.share"


def worker(body: str) -> list[str]:
    return [sys.executable, "-c", f"import sys\n{body}"]


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ("sys.exit(3)", "main cannot be measured: its process has ended"),
        ("""input(); print('{"error": "no joint."}')""", "main cannot be measured: no joint."),
        (
            """input(); print('{"error": "no module", "kind": "ImportError"}')""",
            r"main cannot be measured: it is older than `rtagent bench`, or lacks a package \(no module\)\.",
        ),
    ],
)
def test_what_cannot_be_measured_is_told(body: str, sentence: str) -> None:
    with pytest.raises(BaselineError, match=sentence), workers(("main", worker(body))) as (one,):
        one.times()


FAKE = """
import json, itertools
for number, line in enumerate(sys.stdin):
    print(json.dumps({"done": {"reaction": [TIME + number] * 20}}), flush=True)
"""


def test_each_side_is_measured_by_several_processes_in_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SHARE, 0.0)
    sides = [(name, worker(FAKE.replace("TIME", time))) for name, time in (("main", "10000"), ("mine", "12000"))]
    comparison, rounds = beside(sides[0], sides[1], Rules(rounds=6, stolen=1.0), 1.1, pairs=2)
    assert comparison["reaction"].ratio == pytest.approx(1.2, abs=0.001)
    assert [each.blocks[0]["reaction"][0] for each in rounds] == [10_001, 10_002, 10_003] * 2
    assert comparison["reaction"].verdict(1.1) is Kept.SLOWER


def test_rounds_that_others_disturbed_are_measured_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    warm_up_and_two_rounds = 2 + 2 * 2
    lost = itertools.chain([0.5] * warm_up_and_two_rounds, itertools.repeat(0.0))
    monkeypatch.setattr(SHARE, property(lambda _: next(lost)))
    sides = [(name, worker(FAKE.replace("TIME", "10000"))) for name in ("main", "mine")]
    _, rounds = beside(sides[0], sides[1], Rules(rounds=6), 1.1, pairs=2)
    assert len(rounds) == 1 + 3 + 3, "two pairs left four of six"


@pytest.mark.parametrize(
    ("odd", "even", "pairs"), [("12000", "10500", 4), ("12500", "11500", 2), ("10500", "9600", 2)]
)
def test_what_looks_slower_and_is_not_surely_so_is_measured_on(
    monkeypatch: pytest.MonkeyPatch, odd: str, even: str, pairs: int
) -> None:
    monkeypatch.setattr(SHARE, 0.0)
    mine = FAKE.replace("TIME", f"({odd} if number % 2 else {even})")
    sides = [("main", worker(FAKE.replace("TIME", "10000"))), ("mine", worker(mine))]
    _, rounds = beside(sides[0], sides[1], Rules(rounds=6, stolen=1.0), 1.1, pairs=2)
    assert len(rounds) == 3 * pairs


def test_a_revision_that_is_none_is_told(tmp_path: Path) -> None:
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c"]
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)  # noqa: S607
    subprocess.run([*git, "commit", "-q", "--allow-empty", "-m", "x"], cwd=tmp_path, check=True)
    with pytest.raises(BaselineError, match="has no revision 'mian': give a branch, a tag or a commit"):
        installed("mian", print, tmp_path)
    with pytest.raises(BaselineError, match="not a git repository"):
        installed("main", print, Path("/"))


@pytest.mark.slow
def test_another_revision_is_installed_beside_and_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c"]
    subprocess.run(["git", "clone", "-q", str(ROOT), str(other)], check=True)  # noqa: S607
    task = other / "rtagent" / "tasks" / "stopping.py"
    wasteful = "        waste = [object(), object()]\n"
    head, place, rest = task.read_text().partition("    def interpret(")
    signature, doc, body = rest.partition('"""\n')
    task.write_text("".join([head, place, signature, doc, wasteful, body]))
    subprocess.run([*git, "commit", "-qam", "wasteful"], cwd=other, check=True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(other)
    assert main([*BENCH, "--against", "HEAD"]) == 0
    printed = capsys.readouterr().out
    (row,) = [line for line in printed.splitlines() if line.startswith("allocations in a cycle")]
    assert row.split()[-1] == "fewer", printed


@pytest.mark.slow
def test_the_machine_alone_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--floor", "--rounds", "5", "--stolen", "1"]) == 0
    assert "1000 sleeps of 1 ms" in capsys.readouterr().out


def allocations_of(data: Any) -> dict[str, float]:
    counts: dict[str, float] = data["scenarios"]["stopping"]["exact"]["counts"]["allocations"]["per_cycle"]
    return counts


@pytest.mark.slow
def test_a_baseline_in_real_time_with_all_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = tmp_path / "base.json"
    keys = ["--set", "devices.joint.onset=['10ms', '20ms']", "--set", "schedule.learn_delay=1ms", "--stolen", "1"]
    quick = ["--episodes", "12", "--rounds", "5"]
    assert main(["bench", STOPPING, *keys, *quick, "--save", str(base)]) == 0
    kept = read(base).scenarios["stopping"]
    expected = {"reaction", "act", "observe", "choose", "learning", "age of joint", "wake-up"}
    assert expected <= kept.times.values.keys()
    assert kept.exact.counts["allocations"].total > 100
    assert any(name.startswith("choose: rtagent.") for name in kept.exact.counts["allocations"].per_cycle)
    assert not kept.exact.notes
    same = Latency(Rules(rounds=5, stolen=1.0)).to_baseline(STOPPING, base, *kept.keys)
    assert same["choose"].before == pytest.approx(float(np.median(kept.times.values["choose"])))
    with pytest.raises(AssertionError, match=r"is slower than 0.01 × .*base.json"):
        same.assert_at_most(0.01, "choose")
    changed(base, lambda data: allocations_of(data).popitem())
    assert main(["bench", "--compare", str(base), "--rounds", "5", "--stolen", "1"]) == 1
    assert re.search(r"got worse: allocations in \w+: [\w.]+: 0 before", capsys.readouterr().out)
