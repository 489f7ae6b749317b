"""Prediction from a recording, as a user runs it: one of the fake arm, and one of their own, at the first try."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from parts import SCENARIOS

from rtagent.__main__ import main
from rtagent.errors import ScenarioError
from rtagent.scenario import assemble, load
from rtagent_drivers.tables import Table, write_table

PREDICT = str(SCENARIOS / "predict.toml")
SMALL = ["--set", "features.prototypes=200"]
SHORT = [*SMALL, "--set", "devices.arm.arm.duration=20s"]


def own_recording(path: Path) -> Path:
    """Write three sessions of a user's own: 601 rows, of which 3 hold a glitch, and a gap."""
    times = np.concatenate([np.arange(200), np.arange(200), np.arange(201)]) * 0.1
    times[300:400] += 3.0
    angle = 500.0 + 400.0 * np.sin(np.arange(601) / 9.0)
    angle[[0, 250, 600]] = -16_245.0
    sessions = ["monday"] * 200 + ["tuesday"] * 200 + ["friday"] * 201
    write_table(Table(times, sessions, {"base_position": angle, "base_load": np.cos(angle)}), path)
    return path


def test_demons_predict_what_the_fake_arm_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", PREDICT, *SHORT]) == 0
    out, err = capsys.readouterr()
    assert "predict: 1 × 1 episodes, custom order, virtual clock, seed 1" in out
    assert "the fake arm's recording: 601 rows of 20 signals in 1 session, 20 s, one every 33.3 ms." in out
    assert "episode 1 of 1, 600 steps" in out
    assert re.search(r"^learn +600 ", out, re.MULTILINE)
    assert "reaction" not in out
    assert "return: mean" not in out
    assert "Traceback" not in err


def test_a_report_is_not_drowned_in_glitches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.csv"
    rows = [f"{row},{row % 7 if row % 10 else -1000 - row}\n" for row in range(250)]
    path.write_text("t,x\n" + "".join(rows))
    signals = "devices.arm.signals={ x = { low = 0, high = 10 } }"
    assert main(["run", PREDICT, *SMALL, "--data", str(path), "--set", signals]) == 0
    out = capsys.readouterr().out
    assert out.count("a sample was not usable") == 10
    assert "and 14 other sentences of this kind; --json has them." in out
    assert re.search(r"arm\.invalid_samples 24, +arm\.x_outside +25", out.replace("\n", " "))


@pytest.mark.parametrize("name", ["mine.csv", "mine.csv.gz", "mine.npz"])
def test_a_recording_of_ones_own_works_at_the_first_try(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = own_recording(tmp_path / name)
    assert main(["run", PREDICT, *SMALL, "--data", str(path), "--quiet", "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    episodes = result["trials"][0]["episodes"]
    assert [each["steps"] for each in episodes] == [198, 198, 199]
    assert [each["truncated"] for each in episodes] == [True] * 3
    assert result["components"]["learn"]["count"] == 595
    # what comes before the first usable row and after the last is not handed on, but counted
    assert result["devices"]["arm"] == {"base_position_outside": 3, "gaps": 1, "invalid_samples": 1}
    assert result["counters"].get("observe_timeouts", 0) == 0


def test_the_resolved_copy_repeats_a_run_with_data(tmp_path: Path) -> None:
    path = own_recording(tmp_path / "mine.csv")
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    assert main(["run", PREDICT, *SMALL, "--data", str(path), "--quiet", "--json", str(first)]) == 0
    assert main(["run", str(tmp_path / "first.scenario.toml"), "--quiet", "--json", str(second)]) == 0
    assert first.read_bytes() == second.read_bytes()


def test_check_tells_what_is_in_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = own_recording(tmp_path / "mine.csv")
    assert main(["check", PREDICT, *SMALL, "--data", str(path)]) == 0
    out = capsys.readouterr().out
    for sentence in (
        "1 × 3 episodes, virtual clock",
        "mine.csv: 601 rows of 2 signals in 3 sessions, 62.8 s, one every 100 ms.",
        "No ranges were declared; guessed from the values: base_position ",
        "3 of 601 rows hold values outside their range, or none, and are left out: base_position outside 3; ",
        "the first is row 1.",
        "1 gap is longer than 5 intervals; the longest, 3.1 s, ends with row 301.",
    ):
        assert sentence in out


def test_declared_signals_are_kept_under_new_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = own_recording(tmp_path / "mine.csv")
    signals = '{ angle_position = { column = "base_position", low = 0, high = 1000, unit = "counts" } }'
    arguments = ["--data", str(path), "--set", f"devices.arm.signals={signals}"]
    assert main(["check", PREDICT, *SMALL, *arguments]) == 0
    out = capsys.readouterr().out
    assert "senses angle_position, ended" in out
    assert "guessed" not in out


def test_some_signals_are_predicted_where_only_those_are_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", PREDICT, *SHORT, "--set", 'learner.demons.0.signals=["*_load"]']) == 0
    predicted = set(re.findall(r"^(\w+) γ=", capsys.readouterr().out, re.MULTILINE))
    assert predicted == {
        f"{joint}_load" for joint in ("shoulder", "elbow", "wrist_rotation", "wrist_flexion", "hand")
    }


def test_the_number_of_episodes_can_be_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = own_recording(tmp_path / "mine.csv")
    arguments = ["--data", str(path), "--episodes", "4", "--quiet", "--json", "-"]
    assert main(["run", PREDICT, *SMALL, *arguments]) == 0
    episodes = json.loads(capsys.readouterr().out)["trials"][0]["episodes"]
    assert [each["steps"] for each in episodes] == [198, 198, 199, 198]


@pytest.mark.parametrize(
    ("content", "settings", "sentence"),
    [
        (None, [], "there is no file"),
        ("", [], "is empty"),
        ("a,b\n1,2\n", [], "say which it is with time, one of a, b"),
        ("t,x_position\n", [], "has no rows"),
        ("t,x_position\n0,1\n1,two\n2,3\n", [], "row 2: 'two' in column 'x_position' is no number"),
        ("t,x_position\n1,1\n0,2\n", [], "row 2: the times in column 't' do not increase"),
        ("t,x_position\n0,1\n1,2\n", ["time=tea"], "no column 'tea': use one of t, x_position."),
        ("t,x_position\n0,1\n1,2\n", ["speed=0"], "speed is 0.0"),
        (
            "t,x_position\n0,1\n1,2\n",
            ["signals.y_position={}"],
            "no column 'y_position': did you mean 'x_position'?",
        ),
        (
            "t,x_position\n0,1\n1,2\n",
            ["signals.x_position.lo=1"],
            "there is no key 'devices.arm.signals.x_position.lo': did you mean 'low'?",
        ),
    ],
)
def test_a_bad_recording_is_told_in_one_sentence_before_anything_runs(
    tmp_path: Path, content: str | None, settings: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.csv"
    if content is not None:
        path.write_text(content)
    sets = [word for setting in settings for word in ("--set", f"devices.arm.{setting}")]
    for command in ("check", "run"):
        assert main([command, PREDICT, "--data", str(path), *sets]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert sentence in err
        assert len(err.splitlines()) == 1


def test_data_needs_a_recording_to_go_to(capsys: pytest.CaptureFixture[str]) -> None:
    scenario = str(SCENARIOS / "stopping.toml")
    assert main(["run", scenario, "--data", "mine.csv"]) == 2
    assert 'stopping.toml has no device with driver = "recording"' in capsys.readouterr().err


def test_all_episodes_need_a_device_that_has_an_end() -> None:
    with pytest.raises(ScenarioError, match="0 episodes are all that a device has, but none here comes to an end"):
        assemble(load(SCENARIOS / "stopping.toml", ["run.episodes=0"]))


def test_the_arm_itself_can_be_predicted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = Path(PREDICT).read_text()
    device = re.search(r"driver = .*\narm = .*\n", text)
    assert device is not None
    path = tmp_path / "arm.toml"
    path.write_text(text.replace(device[0], 'driver = "arm"\njoints = 2\n').replace("episodes = 0", "episodes = 2"))
    assert main(["run", str(path), *SMALL, "--set", "run.episode_steps=90", "--quiet", "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [each["duration_s"] for each in result["trials"][0]["episodes"]] == [3.0, 3.0]
