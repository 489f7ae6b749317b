from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from wire import EmulatedArm

from rtagent_drivers.dynamixel import last_resort
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.last_resort import open_spare

pytestmark = pytest.mark.slow

HEAVY = ("asyncio", "numpy", "pydantic", "serial")


@pytest.fixture(scope="module", params=["bento", "mini_bento"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path_factory.mktemp("arm"), request.param) as emulated:
        yield emulated


@pytest.fixture(autouse=True)
def _hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(last_resort, "WITHIN", 0.4)


async def moving(arm: EmulatedArm, **settings: Any) -> Dynamixel:
    """Return a driver whose shoulder and elbow are on their way."""
    joints = arm.joints(mode="velocity", low=-1.5, high=1.5)
    device = Dynamixel(
        port=arm.port, joints=joints, protocol=arm.protocol, rate=100.0, silence=0, bus_watchdog=0, **settings
    )  # type: ignore[arg-type]
    await device.open()
    await device.act({"shoulder_velocity": 0.5, "elbow_velocity": 0.5})
    await device.read((await device.read(-1)).sequence + 3)
    return device


async def test_beside_the_owner_it_lets_go_at_once(arm: EmulatedArm) -> None:
    device = await moving(arm)
    spare = open_spare(json.loads(json.dumps(device.last_resort().settings)))
    assert spare.make_safe() == []
    assert not any(joint["torque"] for joint in arm.state().values())
    spare.close()
    await device.close()


async def test_it_holds_what_is_on_and_leaves_the_rest_limp(arm: EmulatedArm) -> None:
    device = await moving(arm)
    settings = {**device.last_resort().settings, "stop": "home"}  # which only the driver itself can go
    spare = open_spare(settings)
    assert spare.make_safe() == []
    spare.close()
    before = arm.state()
    assert {name for name, joint in before.items() if joint["torque"]} == {"shoulder", "elbow"}
    await asyncio.sleep(0.15)
    assert abs(arm.state()["elbow"]["position"] - before["elbow"]["position"]) < 0.1
    await device.make_safe()
    await device.close()


async def test_it_gets_through_when_garbage_has_cleared(arm: EmulatedArm) -> None:
    device = await moving(arm)
    spare = open_spare(device.last_resort().settings)
    arm.fault("babble", duration="150ms")
    assert spare.make_safe() == []
    assert not any(joint["torque"] for joint in arm.state().values())
    spare.close()
    await device.close()


async def test_it_finds_the_port_again_when_it_was_plugged_in_anew(arm: EmulatedArm) -> None:
    device = await moving(arm)
    spare = open_spare(device.last_resort().settings)
    await device.close()
    arm.fault("unplug", duration="150ms")
    assert spare.make_safe() == []
    assert not any(joint["torque"] for joint in arm.state().values())
    spare.close()


async def test_it_names_what_does_not_confirm(arm: EmulatedArm) -> None:
    device = await moving(arm)
    arm.fault("silent", 2)
    spare = open_spare(device.last_resort().settings)
    assert spare.make_safe() == ["elbow (id 2) did not confirm that it is safe: switch its power off."]
    assert not arm.state()["shoulder"]["torque"]
    spare.close()
    arm.mend()
    await device.close()


def test_a_port_that_is_not_there_is_told_for_every_joint() -> None:
    settings = {"port": "/nowhere/at/all", "baud": 1_000_000, "protocol": 1, "stop": "release"}
    spare = open_spare({**settings, "servos": [[1, "shoulder", "MX-64", "position"]]})
    said = spare.make_safe()
    assert len(said) == 1
    assert said[0].startswith("shoulder (id 1) did not confirm that it is safe (/nowhere/at/all: [Errno 2]")


def test_it_imports_neither_a_loop_nor_arrays() -> None:
    code = f"import sys, rtagent_drivers.dynamixel.last_resort; print([m for m in {HEAVY} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert found.stdout.strip() == "[]"
