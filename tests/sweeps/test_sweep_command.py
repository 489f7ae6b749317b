"""`rtagent sweep` and the table [sweep]: every combination with every seed, a row each, its scenario beside it."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from parts import SCENARIOS

from rtagent import clock
from rtagent.__main__ import main
from rtagent.scenario import assemble, json_schema, load
from rtagent.sweeps.plan import parse_over, plan

STOPPING = str(SCENARIOS / "stopping.toml")
FAST = ["--clock", "virtual", "--set", "run.episodes=2", "--quiet"]
TABLE = """
[sweep]
trials = 2

[sweep.over]
schedule.preset = ["standard", "reactive"]
"devices.joint.onset" = [["0.5s", "0.6s"], ["0.7s", "0.8s"]]
"""


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def swept(tmp_path: Path, *arguments: str, scenario: str = STOPPING) -> tuple[int, list[dict[str, str]]]:
    out = tmp_path / "results.csv"
    code = main(["sweep", scenario, *FAST, "--out", str(out), "--jobs", "1", *arguments])
    return code, rows(out) if out.exists() else []


def with_table(tmp_path: Path, table: str = TABLE) -> str:
    path = tmp_path / "swept.toml"
    path.write_text(Path(STOPPING).read_text() + table)
    return str(path)


def test_each_combination_has_a_row_for_each_seed_as_a_run_alone_would_have_it(tmp_path: Path) -> None:
    over = ("--over", "schedule.preset=standard,reactive", "--over", "schedule.learn_delay=0.1s,50ms")
    code, found = swept(tmp_path, *over, "--trials", "2", "--set", "run.seed=5")
    assert code == 0
    assert [(row["schedule.preset"], row["schedule.learn_delay"], row["seed"]) for row in found] == [
        (preset, delay, seed)
        for preset in ("standard", "reactive")
        for delay in ("0.1s", "50ms")
        for seed in ("5", "6")
    ]
    settings = ["run.clock=virtual", "run.episodes=2", "run.seed=6", "schedule.preset=reactive"]
    alone = clock.run(assemble(load(STOPPING, [*settings, "schedule.learn_delay=100ms"])).run(), "virtual")
    row = found[5]
    assert list(row)[:5] == ["run", "schedule.preset", "schedule.learn_delay", "seed", "ended"]
    assert json.loads(row["returns"]) == [episode.total_reward for episode in alone.episodes]
    assert float(row["reaction_median_s"]) == alone.reaction_time.median / 1e9
    assert (row["ended"], row["episodes"]) == ("done", "2")


def test_the_scenario_beside_a_row_gives_the_row_again(tmp_path: Path) -> None:
    swept(tmp_path, "--over", "schedule.learn_delay=30ms,60ms")
    beside = tmp_path / "results.scenarios" / "0001.toml"
    assert tomllib.loads(beside.read_text())["schedule"]["learn_delay"] == "60ms"
    again = clock.run(assemble(load(beside)).run(), "virtual")
    returns = json.loads(rows(tmp_path / "results.csv")[1]["returns"])
    assert returns == [episode.total_reward for episode in again.episodes]


def test_the_table_says_what_to_sweep_and_the_command_line_more_or_otherwise(tmp_path: Path) -> None:
    path = with_table(tmp_path)
    planned = plan(path, ["run.clock=virtual"], [])
    assert (planned.combinations, len(planned.runs), planned.real) == (4, 8, False)
    assert planned.runs[3].values == {"schedule.preset": "standard", "devices.joint.onset": ["0.7s", "0.8s"]}
    assert [run.seed for run in planned.runs] == [1, 2] * 4
    assert all("sweep" not in run.scenario for run in planned.runs)
    other = plan(path, [], ["schedule.preset=deferred", "learner.alpha=0.1,0.2,0.3"], 1)
    assert len(other.runs) == 2 * 3
    assert {run.values["schedule.preset"] for run in other.runs} == {"deferred"}


def test_a_scenario_with_a_table_runs_as_one_without(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = with_table(tmp_path)
    assert main(["run", path, *FAST]) == 0
    assert main(["check", path]) == 0
    assert "a sweep of 4 combinations, 2 runs each" in capsys.readouterr().out
    assert load(path).model.sweep is not None
    assert load(path).resolved()["sweep"]["over"]["schedule.preset"] == ["standard", "reactive"]


@pytest.mark.parametrize(
    ("text", "key", "values"),
    [
        ("a.b=1,2.5,true", "a.b", [1, 2.5, True]),
        ("a=50ms, 100ms", "a", ["50ms", "100ms"]),
        ('a=["1s","2s"],["3s","4s"]', "a", [["1s", "2s"], ["3s", "4s"]]),
        ("a=50ms,0", "a", ["50ms", 0]),
        ('a={ rate = "1Hz" }, { rate = "2Hz" }', "a", [{"rate": "1Hz"}, {"rate": "2Hz"}]),
    ],
)
def test_values_are_read_as_toml_where_they_are(text: str, key: str, values: list[Any]) -> None:
    assert parse_over(text) == (key, values)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--over", "schedule.preset"], "--over schedule.preset: write it as key=value,value"),
        (["--over", "schedule.preset="], "write it as key=value,value"),
        (["--over", "schedule.preset=standard,reactve"], "there is no preset 'reactve': did you mean 'reactive'?"),
        (["--over", "schedul.preset=standard"], "there is no key 'schedul': did you mean 'schedule'?"),
        (["--over", "learner.alpha=0.1,-1"], "alpha is -1.0: give a step size above 0 (with learner.alpha=-1)."),
        (["--over", "sweep.trials=1,2"], "a sweep over keys of [sweep] itself makes no sense"),
        (["--trials", "0"], "--trials 0: give 1 or more"),
        (["--jobs", "0"], "--jobs 0: give 1 or more"),
        (["--out", "results.txt"], "the name ends with .csv or .parquet"),
        (["--out", "nowhere/results.csv"], "give a file in a folder that exists"),
        (["--cluster", "somewhere"], "write the scheduler's address as tcp://host:port"),
    ],
)
def test_a_bad_wish_has_a_sentence_and_runs_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", STOPPING, *FAST, *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.glob("*.csv"))


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("[sweep]\ntrials = 0", "sweep.trials: Input should be greater than or equal to 1."),
        ("[sweep]\ntrails = 2", "there is no key 'sweep.trails': did you mean 'trials'?"),
        ('[sweep.over]\nschedule.preset = "standard"', "sweep.over.schedule.preset: Input should be a valid list."),
        ("[sweep.over]\nschedule.preset = []", "sweep.over.schedule.preset: List should have at least 1 item"),
    ],
)
def test_a_bad_table_has_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], table: str, sentence: str
) -> None:
    path = with_table(tmp_path, f"\n{table}\n")
    assert main(["sweep", path, *FAST]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert f"{path}:" in said


def test_the_schema_knows_the_table_in_both_its_forms() -> None:
    validator = jsonschema.Draft202012Validator(json_schema())
    text = Path(STOPPING).read_text()
    validator.validate(tomllib.loads(text + TABLE))
    for wrong in ("schedule.preset = []", '"schedule.preset" = "standard"'):
        with pytest.raises(jsonschema.ValidationError):
            validator.validate(tomllib.loads(f"{text}\n[sweep.over]\n{wrong}\n"))


def test_fewer_runs_leave_no_scenario_of_others_behind(tmp_path: Path) -> None:
    swept(tmp_path, "--trials", "3")
    swept(tmp_path, "--trials", "2")
    assert sorted(path.name for path in (tmp_path / "results.scenarios").iterdir()) == ["0000.toml", "0001.toml"]


def test_other_results_are_not_lost(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.csv").write_text("mine\n")
    assert main(["sweep", STOPPING, *FAST, "--out", str(tmp_path / "results.csv")]) == 2
    assert "would be lost" in capsys.readouterr().err
    assert (tmp_path / "results.csv").read_text() == "mine\n"


def test_hardware_is_not_run_several_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = str(SCENARIOS / "bento_stopping.toml")
    out = ["--out", str(tmp_path / "arm.csv")]
    assert main(["sweep", arm, "--over", "run.seed=1,2", "--jobs", "2", *out]) == 2
    assert "move hardware, of which there is one" in capsys.readouterr().err


def test_a_run_that_ends_early_is_in_the_table_and_in_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = swept(tmp_path, "--over", 'devices.joint.faults={ disconnect = [["0.1s"]] },{ drop = 0.0 }')
    assert code == 1
    assert [row["ended"] == "done" for row in found] == [False, True]
    assert "run 0 ended early" in capsys.readouterr().err


def test_parquet_holds_the_same_with_lists_as_lists(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow.parquet")
    over = ["--over", "schedule.learn_delay=0,60ms"]
    code, found = swept(tmp_path, *over)
    out = tmp_path / "results.parquet"
    assert code == main(["sweep", STOPPING, *FAST, *over, "--out", str(out), "--jobs", "1"]) == 0
    table = arrow.read_table(out).to_pylist()
    assert [row["returns"] for row in table] == [json.loads(row["returns"]) for row in found]
    assert [row["schedule.learn_delay"] for row in table] == ["0", "60ms"]


def test_progress_and_time_left_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "results.csv")
    assert main(["sweep", STOPPING, *FAST[:-1], "--over", "run.seed=1,2,3", "--out", out, "--jobs", "1"]) == 0
    told = capsys.readouterr().out
    assert "stopping: 3 combinations, 3 runs, 1 at a time" in told
    assert "2 of 3, 0 s left" in told
    assert f"3 runs are in {out}" in told


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_measured(tmp_path: Path) -> None:
    out = tmp_path / "results.csv"
    command = [
        sys.executable,
        "-m",
        "rtagent",
        "sweep",
        STOPPING,
        "--clock",
        "virtual",
        "--trials",
        "12",
        "--jobs",
        "2",
    ]
    command += ["--out", str(out), "--set", "run.episodes=200"]
    sweep = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    cells = tmp_path / "results.cells"
    until = time.monotonic() + 60
    while not cells.exists() or cells.read_bytes().count(b"\n") < 2:
        assert time.monotonic() < until
        time.sleep(0.01)
    os.killpg(sweep.pid, signal.SIGINT)
    said = sweep.communicate(timeout=30)[1].decode()
    assert sweep.returncode == 1
    assert "What was measured is kept: the same command goes on." in said
    assert "Traceback" not in said
    before = cells.read_bytes()
    subprocess.run(command, check=True, capture_output=True)
    assert cells.read_bytes().startswith(before)
    assert [row["seed"] for row in rows(out)] == [str(seed) for seed in range(1, 13)]
