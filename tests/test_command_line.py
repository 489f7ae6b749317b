"""The command line, as a user runs it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from parts import ROOT, SCENARIOS

from rtagent.__main__ import main

STOPPING = str(SCENARIOS / "stopping.toml")
FAST = ["--clock", "virtual", "--trials", "2", "--episodes", "5"]


def test_run_prints_progress_a_table_and_a_histogram(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", STOPPING, *FAST]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("stopping: 2 × 5 episodes, reactive order, virtual clock, seed 1")
    assert "episode 10 of 10" in out
    assert re.search(r"^reaction +10 ", out, re.MULTILINE)
    assert "█" in out
    assert err == ""


def test_quiet_leaves_standard_output_to_the_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", STOPPING, *FAST, "--seed", "3", "--json", "-", "--quiet"]) == 0
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert err == ""
    assert (result["scenario"], result["seed"], result["clock"]) == ("stopping", 3, "virtual")
    assert result["schedule"]["preset"] == "reactive"
    assert result["faults"] == []
    assert [len(trial["episodes"]) for trial in result["trials"]] == [5, 5]
    for episode in result["trials"][0]["episodes"]:
        assert episode.keys() >= {"return", "steps", "duration_s", "reactions_s", "responses_s", "missed"}
        assert len(episode["reactions_s"]) == 1
    for name in ("reaction_time", "response_time"):
        assert result[name].keys() >= {"count", "median_s", "p90_s", "p99_s", "max_s", "missed"}
        assert result[name]["count"] == 10
    for name in ("act", "observe", "choose", "learn"):
        assert result["components"][name].keys() >= {"count", "median_s", "p99_s", "max_s"}
    assert result["components"]["learn"]["median_s"] == 0.05


def test_without_quiet_the_report_gives_way_to_the_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", STOPPING, *FAST, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["reaction_time"]["count"] == 10
    assert "reaction times" in err


def test_results_are_written_with_a_scenario_that_repeats_them(tmp_path: Path) -> None:
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    assert main(["run", STOPPING, *FAST, "--quiet", "--json", str(first), "--set", "learner.alpha=0.2"]) == 0
    copy = tmp_path / "first.scenario.toml"
    assert tomllib.loads(copy.read_text())["learner"]["alpha"] == 0.2
    assert main(["run", str(copy), "--quiet", "--json", str(second)]) == 0
    assert first.read_bytes() == second.read_bytes()


def test_two_processes_print_the_same_bytes() -> None:
    command = [sys.executable, "-m", "rtagent", "run", STOPPING, *FAST, "--quiet", "--json", "-"]
    first, second = (subprocess.run(command, capture_output=True, check=True).stdout for _ in range(2))
    assert first == second
    assert len(first) > 1000


def test_a_bad_scenario_exits_with_2_and_sentences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(Path(STOPPING).read_text().replace("seed = 1", "sed = 1").replace('"50ms"', "50"))
    for command in ("run", "check"):
        assert main([command, str(bad)]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert "did you mean 'seed'?" in err
        assert "50 has no unit" in err
        assert "Traceback" not in err


@pytest.mark.parametrize("target", ["no/such/folder/out.json", "."])
def test_a_place_that_cannot_be_written_is_refused_before_the_run(
    target: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", STOPPING, "--json", target]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "give a file in a folder that exists" in err


@pytest.mark.parametrize("arguments", [[], ["fly"], ["run"], ["run", STOPPING, "--clock", "sun"], ["list", "bees"]])
def test_bad_usage_exits_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_a_fault_exits_with_1_and_keeps_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.json"
    fault = ["--set", 'devices.joint.faults.disconnect=[["3s"]]']
    assert main(["run", STOPPING, *FAST, *fault, "--json", str(out)]) == 1
    printed, err = capsys.readouterr()
    assert "The run ended early: device 'joint' has not answered" in err
    assert "could not be made safe" in err
    result = json.loads(out.read_text())
    assert len(result["trials"][0]["episodes"]) >= 1
    assert result["faults"][-1]["fatal"] is True
    assert result["not_safe"]
    assert "fault" in printed


def test_check_explains_and_runs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", *map(str, sorted(SCENARIOS.glob("*.toml")))]) == 0
    out = capsys.readouterr().out
    assert "device joint (stopping): senses position" in out
    assert "schedule reactive: observe, choose, act, learn, again and again" in out
    assert "learning costs 50 ms more for each transition" in out


def test_check_warns_of_a_loop_that_nothing_paces(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", STOPPING, "--set", "schedule.learn_delay=0"]) == 0
    assert "keep a core busy" in capsys.readouterr().out
    assert main(["check", STOPPING, "--set", "schedule.preset=standard", "--set", "costs.act=1ms"]) == 0
    out = capsys.readouterr().out
    assert "first observe, choose; then act, observe, choose, learn" in out
    assert "charged under the virtual clock only" in out


@pytest.mark.parametrize(
    ("group", "name"),
    [
        ("drivers", "stopping"), ("drivers", "hallway"), ("tasks", "stopping"), ("features", "binned"),
        ("learners", "expected_sarsa"), ("policies", "epsilon_greedy"), ("schedules", "standard"),
    ],
)  # fmt: skip
def test_list_has_a_line_for_each(group: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", group]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(re.match(rf"{name} +\S.{{10,}}", line) for line in lines)


def test_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "rtagent scenario"


def test_importing_rtagent_or_asking_for_help_loads_nothing_heavy() -> None:
    code = (
        "import sys, rtagent.__main__ as m\n"
        "try: m.main(['--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'numpy', 'pydantic', 'rich', 'asyncio', 'tree_sitter'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.splitlines()[-1] == "[]"


def test_the_ten_lines_of_the_readme_run(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert blocks
    for block in blocks:
        quick = block.replace("episodes=20", "episodes=1")
        done = subprocess.run(
            [sys.executable, "-c", quick], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout
