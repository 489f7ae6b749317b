from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from wire import EmulatedArm

from rtagent.__main__ import main
from rtagent.errors import DeviceError, SpecError
from rtagent.units import ms
from rtagent_drivers.dynamixel.calibrating import calibrate
from rtagent_drivers.dynamixel.calibration import read_calibration
from rtagent_drivers.dynamixel.driver import Dynamixel

SCENARIO = """
[schedule]
preset = "standard"
[devices.arm]
driver = "dynamixel"
port = "{port}"
calibration = "{file}"
joints.shoulder = {{ id = 1, model = "MX-64" }}
[task]
type = "signals"
[features]
type = "tabular"
[learner]
type = "td"
"""


class Hand:
    """A person whose hands are the emulator's: moves joints as the script says, step by step."""

    def __init__(self, arm: EmulatedArm, script: Mapping[str, Mapping[str, list[float]]]) -> None:
        self._arm, self._script = arm, script
        self.told: list[str] = []
        self.seen: Mapping[str, str] = {}

    async def does(self, instruction: str, live: Callable[[], Mapping[str, str]]) -> None:
        self.told.append(instruction)
        for part, moves in self._script.items():
            if part in instruction:
                for joint, places in moves.items():
                    for place in places:
                        await self._move(joint, place)
        self.seen = live()

    async def _move(self, joint: str, place: float) -> None:
        self._arm.tell(do="move", joint=joint, to=f"{place}rad")
        async with asyncio.timeout(5):
            while abs(self._arm.state()[joint]["position"] - place) > 0.005:  # noqa: ASYNC110  # no event
                await asyncio.sleep(0.02)
        await asyncio.sleep(0.03)


def settings(arm: EmulatedArm, file: Path) -> dict[str, Any]:
    joints = {name: joint for name, joint in arm.joints(start=0.0).items() if name in ("shoulder", "hand")}
    patient = {"bus_watchdog": 2000 * ms, "silence": 0}
    return {"port": arm.port, "joints": joints, "calibration": str(file), "rate": 100.0, **patient}


@pytest.mark.slow
async def test_an_arm_is_calibrated_by_hand_and_then_driven_by_it(tmp_path: Path) -> None:
    script = {
        "angle is to be 0": {"shoulder": [0.1]},
        "shoulder in its positive": {"shoulder": [0.25]},
        "hand in its positive": {"hand": [-0.05, -0.15]},
        "shoulder to both ends": {"shoulder": [0.3, -0.1]},
        "hand to both ends": {"hand": [-0.2, 0.2]},
    }
    with EmulatedArm(tmp_path) as arm:
        hand, given = Hand(arm, script), settings(arm, tmp_path / "arm.toml")
        said = await calibrate(hand, **given)
        assert said == f"{tmp_path}/arm.toml has the zero, direction and limits of shoulder, hand."
        assert hand.told[0] == "Hold the arm: its torque goes off now."
        assert hand.seen["shoulder"].startswith("-0.10")
        placed = read_calibration(tmp_path / "arm.toml")
        shoulder, its_hand = placed["shoulder"], placed["hand"]
        assert (shoulder.direction, its_hand.direction) == (1, -1)
        found = (shoulder.zero, shoulder.low, shoulder.high, its_hand.zero, its_hand.low, its_hand.high)
        assert found == pytest.approx((0.1, -0.18, 0.18, 0.0, -0.18, 0.18), abs=0.015)
        driver = Dynamixel(**given)
        await driver.open()
        assert float((await driver.read(-1)).values["shoulder_position"]) == pytest.approx(-0.2, abs=0.02)
        sent = await driver.act({"hand_position": 9.0})
        assert sent["hand_position"] == pytest.approx(0.18, abs=0.02)
        await driver.make_safe()
        await driver.close()


async def test_what_goes_wrong_with_the_arm_ends_it_and_writes_nothing(tmp_path: Path) -> None:
    with EmulatedArm(tmp_path) as arm:

        class Clumsy(Hand):
            async def does(self, instruction: str, live: Callable[[], Mapping[str, str]]) -> None:
                if "angle is to be 0" in instruction:
                    arm.fault("unplug")
                    await asyncio.sleep(5)

        with pytest.raises(DeviceError):
            await calibrate(Clumsy(arm, {}), **settings(arm, tmp_path / "arm.toml"))
    assert not (tmp_path / "arm.toml").exists()


async def test_it_needs_a_file_to_write_to(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="give it calibration ="):
        await calibrate(None, joints={}, calibration="")  # type: ignore[arg-type]
    with pytest.raises(SpecError, match=r"there is no folder .*nowhere: make it first"):
        await calibrate(None, joints={}, calibration=str(tmp_path / "nowhere" / "arm.toml"))  # type: ignore[arg-type]


def test_where_nobody_turns_a_joint_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario, file = tmp_path / "arm.scenario.toml", tmp_path / "arm.toml"
    reading, writing = os.pipe()
    os.write(writing, b"\n\n\n\n")
    os.close(writing)
    with EmulatedArm(tmp_path) as arm, os.fdopen(reading) as keys:
        scenario.write_text(SCENARIO.format(port=arm.port, file=file))
        monkeypatch.setattr("sys.stdin", keys)
        assert main(["calibrate", str(scenario)]) == 1
    out, err = capsys.readouterr()
    assert out.count("Turn shoulder in its positive direction") == 3
    assert err == ("nobody is there to calibrate: run it where somebody can press Enter.\nNothing was written.\n")
    assert not file.exists()


def test_a_scenario_without_anything_to_calibrate_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    scenario = Path(__file__).parents[2] / "scenarios" / "stopping.toml"
    assert main(["calibrate", str(scenario)]) == 2
    assert "there is nothing to calibrate; dynamixel can be." in capsys.readouterr().err
