"""The driver's two fakes: each keeps the contract, and both do what the driver on a true arm would."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rtagent import clock
from rtagent.clock import ClockName
from rtagent.device import Device, Guarded
from rtagent.errors import DeviceError, DisconnectedError, LimitError, SpecError
from rtagent.experience import Sample
from rtagent.testing import DeviceContract
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.fakes import EmulatedArm, in_process, on_wire
from rtagent_drivers.dynamixel.settings import FakeSettings, Joint
from rtagent_drivers.fake import Faults

JOINTS = {
    "shoulder": Joint(1, "MX-64", mode="velocity", low=-1.0, high=1.0, start=0.5),
    "elbow": Joint(2, "MX-106", low=-1.5, high=1.5, start=0.3),
    "wrist_rotation": Joint(3, "MX-64", mode="torque"),
    "wrist_flexion": Joint(4, "MX-28", mode="wheel", zero=0.2, direction=-1),
}
MINI = {"elbow": Joint(2, "XL330-M288", low=-1.5, high=1.5)}
MADE = {"process": in_process, "wire": on_wire}


def arm(level: str = "process", joints: Mapping[str, Joint] = JOINTS, **settings: Any) -> Any:
    return Dynamixel.fakes[level](**{"port": "auto", "joints": joints, "rate": 200.0, **settings})


@pytest.fixture(scope="module")
def emulated() -> EmulatedArm:
    return on_wire(port="auto", joints=MINI, protocol=2, rate=200.0)


class TestInTheProcess(DeviceContract):
    clock: ClockName = "virtual"

    def make_device(self) -> Device:
        return arm()


class TestOnTheWire(DeviceContract):
    @pytest.fixture(autouse=True)
    def _arm(self, emulated: EmulatedArm) -> None:
        self._emulated = emulated

    def make_device(self) -> Device:
        return self._emulated  # opened and closed by each test: its bus goes on


@pytest.fixture(params=MADE)
def level(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def run(level: str, work: Any) -> Any:
    return clock.run(work, "virtual" if level == "process" else "real")


async def until(device: Device, name: str, value: float) -> Sample:
    sample = await device.read(-1)
    for _ in range(1000):
        if abs(float(sample.values[name]) - value) < 0.02:
            return sample
        sample = await device.read(sample.sequence)
    raise AssertionError(f"{name} is {sample.values[name]}, not {value}")


@pytest.mark.slow
def test_both_levels_obey_alike() -> None:
    """The same orders take both to the same places, under the same limits, in the joints' own coordinates."""

    async def told(device: Device) -> tuple[Any, ...]:
        await device.open()
        await device.begin_episode(np.random.default_rng(1))  # type: ignore[attr-defined]
        began = await until(device, "elbow_position", 0.3)
        sent = await device.act(
            {
                "shoulder_velocity": 1.0,
                "elbow_position": 9.0,
                "wrist_rotation_torque": 0.0,
                "wrist_flexion_velocity": 2.0,
            }
        )
        await until(device, "elbow_position", 1.5)
        end = await until(device, "shoulder_position", 1.0)  # it ends by itself at its soft limit
        await device.make_safe()
        await device.close()
        return dict(began.values), sent, dict(end.values)

    first, second = (run(level, told(arm(level))) for level in MADE)
    assert first[1] == second[1]
    assert first[1]["elbow_position"] == pytest.approx(1.5, abs=0.002)
    assert first[0].keys() == second[0].keys()
    for name in ("shoulder_position", "elbow_position", "elbow_temperature", "elbow_voltage"):
        assert first[0][name] == pytest.approx(second[0][name], abs=0.1), name
    for name in ("shoulder_position", "elbow_position", "wrist_flexion_velocity", "wrist_rotation_position"):
        assert first[2][name] == pytest.approx(second[2][name], abs=0.05), name


@pytest.mark.slow
def test_an_episode_begins_at_the_start_pose(level: str) -> None:
    async def begun(device: Device) -> Sample:
        await device.open()
        before = await device.read(-1)
        assert before.values["elbow_position"] == pytest.approx(0.5, abs=0.05)
        await device.begin_episode(np.random.default_rng(1))  # type: ignore[attr-defined]
        sample = await until(device, "elbow_position", 0.3)
        await device.make_safe()
        await device.close()
        return sample

    joints = {"elbow": JOINTS["elbow"]}
    run(level, begun(arm(level, joints, fake=FakeSettings(positions={"elbow": 0.5}))))


@pytest.mark.parametrize(("stop", "comes_to"), [("hold", 0.9), ("release", -1.4), ("home", -1.4)])
def test_it_is_made_safe_by_its_stop_policy(stop: str, comes_to: float) -> None:
    async def stopped(device: Device) -> float:
        await device.open()
        await device.begin_episode(np.random.default_rng(1))  # type: ignore[attr-defined]
        await device.act({"elbow_position": 0.9})
        sample = await until(device, "elbow_position", 0.9)
        await device.make_safe()
        for _ in range(20 * 10):
            sample = await device.read(sample.sequence)
        return float(sample.values["elbow_position"])

    position = run("process", stopped(arm(joints={"elbow": JOINTS["elbow"]}, stop=stop, rate=20.0)))
    assert position == pytest.approx(comes_to, abs=0.05)


def test_a_blocked_joint_is_a_fault_in_the_driver_s_words() -> None:
    joints = {"elbow": Joint(2, "MX-106", low=-1.5, high=1.5, max_load=0.2)}

    async def overdone(device: Any) -> None:
        await device.open()
        await device.read(-1)
        await device.act({"elbow_position": 0.9})  # gravity alone takes 0.35
        sample = await device.read(-1)
        for _ in range(400):
            sample = await device.read(sample.sequence)

    with pytest.raises(LimitError, match="elbow"):
        run("process", overdone(arm(joints=joints)))


def test_faults_of_a_fake_in_the_process_are_those_of_every_fake() -> None:
    fake = FakeSettings(faults=Faults(disconnect=((0, 10),)))

    async def opened() -> None:
        await arm(fake=fake).open()

    with pytest.raises(DisconnectedError):
        run("process", opened())


@pytest.mark.slow
def test_faults_on_the_wire_reach_the_driver() -> None:
    fake = FakeSettings(wire=('{"kind": "silent", "servo": 2}',))
    with pytest.raises(DeviceError, match=r"no answer from elbow \(id 2\)"):
        run("wire", arm("wire", MINI, protocol=2, fake=fake).open())


def test_an_emulated_bus_that_does_not_begin_says_why() -> None:
    fake = FakeSettings(wire=('{"kind": "tired"}',))
    with pytest.raises(DeviceError, match=r"the emulator did not begin: .*kind"):
        run("wire", arm("wire", MINI, protocol=2, fake=fake).open())


def test_only_what_is_on_the_wire_is_guarded_and_it_is_no_hardware() -> None:
    emulated = arm("wire", MINI, protocol=2)
    assert isinstance(emulated, Guarded)
    assert emulated.last_resort().hardware == ""
    assert not isinstance(arm(), Guarded)


@pytest.mark.parametrize(
    "settings",
    [
        {"rate": 0.0},
        {"joints": {}},
        {"joints": {"a": Joint(1, "XL330-M288")}},
        {"stop": "home", "joints": {"a": Joint(1, "MX-28")}},
    ],
)
def test_a_fake_refuses_what_the_driver_refuses(level: str, settings: dict[str, Any]) -> None:
    given = {"port": "auto", "joints": JOINTS, **settings}
    with pytest.raises(SpecError) as refused:
        MADE[level](**given)
    with pytest.raises(SpecError) as by_the_driver:
        Dynamixel(**given)
    assert str(refused.value) == str(by_the_driver.value)


OWNER = """
from rtagent import clock
from rtagent_drivers.dynamixel import fakes
from rtagent_drivers.emulation import starting
from rtagent_drivers.dynamixel.settings import Joint
import os, signal
starting.LINGER = "300ms"
arm = fakes.on_wire(port="auto", joints={"elbow": Joint(2, "XL330-M288")}, protocol=2)
clock.run(arm.open())
print(arm.last_resort().settings["port"], flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
def test_the_bus_outlives_its_owner_for_a_while_only() -> None:
    owner = subprocess.run([sys.executable, "-c", OWNER], capture_output=True, text=True, check=False)
    port = Path(owner.stdout.strip())
    assert (owner.returncode, port.is_symlink()) == (-signal.SIGKILL, True)
    ends = time.monotonic() + 20
    while port.is_symlink():
        assert time.monotonic() < ends, "the emulated bus goes on for ever"
        time.sleep(0.02)
