"""`rtagent run --checkpoint` and `--resume`, as a person meets them."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from parts import SCENARIOS

from rtagent.__main__ import main
from rtagent.checkpoint.file import read

STOPPING = str(SCENARIOS / "stopping.toml")
VIRTUAL = (STOPPING, "--clock", "virtual", "--quiet")


def results(path: Path) -> Any:
    data = json.loads(path.read_text())
    del data["resolved"]["checkpoint"]
    return data


def test_a_run_in_two_parts_has_the_results_of_a_whole_one(tmp_path: Path) -> None:
    kept, part, whole = (tmp_path / name for name in ("a.ckpt", "part.json", "whole.json"))
    assert main(["run", *VIRTUAL, "--episodes", "5", "--checkpoint", str(kept)]) == 0
    assert (
        main(["run", *VIRTUAL, "--episodes", "9", "--checkpoint", str(kept), "--resume", "--json", str(part)]) == 0
    )
    assert main(["run", *VIRTUAL, "--episodes", "9", "--json", str(whole)]) == 0
    assert results(part) == results(whole)
    about = read(kept).about
    assert about["scenario"]["name"] == "stopping"
    assert {"digest", "format", "version", "rtagent"} < about.keys()


def test_it_is_told_where_a_run_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = str(tmp_path / "a.ckpt")
    main(["run", *VIRTUAL, "--episodes", "5", "--checkpoint", kept])
    main(["run", *VIRTUAL[:-1], "--episodes", "8", "--checkpoint", kept, "--resume"])
    out = capsys.readouterr().out
    assert f"goes on from {kept}: trial 1, after episode 5\n" in out
    assert "episode 8 of 8" in out


def test_a_run_under_the_real_clock_goes_on_from_a_virtual_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, scenario = str(tmp_path / "a.ckpt"), str(SCENARIOS / "hallway_synchronous.toml")
    assert main(["run", scenario, "--clock", "virtual", "--episodes", "5", "--checkpoint", kept, "--quiet"]) == 0
    assert main(["run", scenario, "--episodes", "7", "--checkpoint", kept, "--resume"]) == 0
    assert read(Path(kept)).saved["place"] == {"trial": 0, "episodes": 7, "open": False}


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["run", *VIRTUAL, *words]) == 2
    return capsys.readouterr().err


def test_what_cannot_be_gone_on_with_is_refused_by_a_sentence_and_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "a.ckpt"
    main(["run", *VIRTUAL, "--episodes", "2", "--checkpoint", str(kept)])
    before = kept.read_bytes()
    there = ("--checkpoint", str(kept))
    assert "is there already, and would be lost: go on from it with --resume" in refused(capsys, *there)
    other = refused(
        capsys, *there, "--resume", "--set", "learner.alpha=0.3", "--seed", "4", "--set", "run.episode_time=9s"
    )
    assert "learner.alpha was 0.1 and is 0.3; run.seed was 1 and is 4; run.episode_time was" in other
    many = refused(capsys, *there, "--resume", "--set", "learner={type='q_learning'}")
    assert "learner.type was" in many
    assert kept.read_bytes() == before
    kept.write_bytes(before[:-100])
    assert "cut off or damaged" in refused(capsys, *there, "--resume")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--resume",), "--resume needs a checkpoint to go on from: give --checkpoint FILE."),
        (("--checkpoint", "/nowhere/a.ckpt"), "give a file in a folder that exists"),
        (("--checkpoint", "/nowhere/a.ckpt", "--resume"), "give a file in a folder that exists"),
        (("--checkpoint", "/"), "give a file in a folder that exists"),
    ],
)
def test_a_place_where_nothing_can_be_kept_is_refused(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in refused(capsys, *words)


def test_a_checkpoint_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "--checkpoint", str(tmp_path / "a.ckpt"), "--resume")
    assert "there is no checkpoint" in said
    assert "run without --resume to begin with one" in said


@pytest.mark.slow
def test_whenever_a_run_is_killed_its_checkpoint_is_whole_and_can_be_gone_on_with(tmp_path: Path) -> None:
    kept = tmp_path / "a.ckpt"
    scenario = str(SCENARIOS / "stopping_horde.toml")
    settings = ["--set", "checkpoint.every=1ms", "--set", "telemetry.enabled=false", "--episodes", "500"]
    command = [sys.executable, "-m", "rtagent", "run", scenario, "--quiet", "--checkpoint", str(kept), *settings]
    found: list[int] = []
    for number in range(6):
        process = subprocess.Popen([*command, *(["--resume"] if kept.exists() else [])])
        before = kept.stat().st_mtime_ns if kept.exists() else 0
        while not kept.exists() or kept.stat().st_mtime_ns == before:
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(0.05 + 0.013 * number)
        process.kill()
        process.wait()
        found.append(sum(each["steps"] for each in read(kept).saved["recorder"]["episodes"]))
    assert found == sorted(found)
    assert found[0] > 0
