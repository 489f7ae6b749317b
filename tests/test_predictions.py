"""What a run that only predicts comes to: errors of demons in results and in the report; recordings as worlds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from parts import SCENARIOS

from rtagent.__main__ import main

pytestmark = pytest.mark.slow

SMALL = ["--set", "devices.arm.arm.duration=60s", "--set", "features.prototypes=200"]


def run(path: Path, *arguments: str) -> dict[str, Any]:
    assert main(["run", str(SCENARIOS / "predict.toml"), "--json", str(path), *SMALL, *arguments]) == 0
    result: dict[str, Any] = json.loads(path.read_text())
    return result


def test_predict_tells_how_its_predictions_turned_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = run(tmp_path / "result.json", "--set", "learner.rupee=true")
    (trial,) = result["trials"]
    assert len(trial["predictions"]) == 40, "20 signals at two time scales"
    errors = trial["predictions"]["elbow_position γ=0.9"]
    assert 0 < errors["mae"] <= errors["rmse"] < 1.0
    assert errors["rupee"] > 0
    assert errors["verified"] + errors["unverified"] == trial["episodes"][0]["steps"] - 1
    assert "elbow_position γ=0.9" in capsys.readouterr().out


def test_a_prediction_run_is_reproducible_to_the_byte(tmp_path: Path) -> None:
    one, other = tmp_path / "one.json", tmp_path / "other.json"
    run(one, "--quiet")
    run(other, "--quiet")
    assert one.read_bytes() == other.read_bytes()


def test_learning_makes_predictions_better(tmp_path: Path) -> None:
    short, long = (
        run(tmp_path / "result.json", "--quiet", "--set", f"devices.arm.arm.duration={duration}")
        for duration in ("30s", "10min")
    )
    before, after = (result["trials"][0]["predictions"]["shoulder_position γ=0.9"] for result in (short, long))
    assert after["mae"] < 0.8 * before["mae"]


def test_keys_within_lists_can_be_set_and_are_told_when_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    check = ["check", str(SCENARIOS / "predict.toml"), "--set"]
    assert main([*check, "learner.demons.0.signals=['elbow_*']"]) == 0
    assert main([*check, "learner.demons.0.signls=['elbow_*']"]) == 2
    assert main([*check, "learner.demons.1.signals=['elbow_*']"]) == 2
    assert main([*check, "learner.demons.0=3"]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said[0].endswith("there is no key 'learner.demons.0.signls': did you mean 'signals'?")
    assert said[1].endswith("'1' is no place in the list.")
    assert said[2].endswith("'0' is a place in a list: name a key of the table there.")


def test_the_horde_of_the_scenario_has_2576_demons(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(SCENARIOS / "horde.toml")
    assert main(["run", path, "--clock", "virtual", "--set", "run.episode_time=2s", "--quiet"]) == 0
    assert main(["check", path]) == 0
    assert "82.4 MB for the weights of 2,576 demons over 8,000 features" in capsys.readouterr().out


def test_the_queue_is_told_over_time(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    late = [
        "--set",
        "schedule.preset=deferred",
        "--set",
        "schedule.learn_delay=500ms",
        "--clock",
        "virtual",
        "--quiet",
    ]
    assert main(["run", str(SCENARIOS / "stopping.toml"), *late, "--json", str(path)]) == 0
    queue = json.loads(path.read_text())["queue_length"]
    assert 20 <= len(queue["over_time"]) <= 100
    assert max(queue["over_time"]) == queue["max"] > 0
