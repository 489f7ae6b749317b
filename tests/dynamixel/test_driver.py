from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wire import EmulatedArm

from rtagent.device import Device, Guarded, Impatient, Unhurried
from rtagent.errors import DeviceError, DisconnectedError, LimitError, SpecError
from rtagent.experience import Sample
from rtagent.testing import DeviceContract
from rtagent.units import ms
from rtagent_drivers.dynamixel import driver as driver_module
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.settings import Joint

WEIGHTLESS = ("shoulder", "wrist_rotation", "hand")
RNG = np.random.default_rng(1)


@pytest.fixture(scope="module")
def bento(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path_factory.mktemp("bento")) as arm:
        yield arm


@pytest.fixture(scope="module")
def mini_bento(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedArm]:
    with EmulatedArm(tmp_path_factory.mktemp("mini"), "mini_bento") as arm:
        yield arm


@pytest.fixture(params=["bento", "mini_bento"])
def arm(request: pytest.FixtureRequest) -> Iterator[EmulatedArm]:
    """Either arm, limp and at rest in the middle of its joints."""
    emulated: EmulatedArm = request.getfixturevalue(request.param)
    emulated.mend()
    for name, joint in emulated.state().items():
        if not joint["torque"]:
            emulated.tell(do="move", joint=name, to=0)
    yield emulated
    emulated.mend()


def driver(arm: EmulatedArm, mode: str = "position", **settings: Any) -> Dynamixel:
    """Return the driver of an arm, which is patient: the machine may be busy elsewhere."""
    joints = settings.pop("joints", None) or arm.joints(mode=mode, low=-1.5, high=1.5)
    patient = {"bus_watchdog": 2000 * ms, "silence": 2000 * ms, **settings}
    return Dynamixel(port=arm.port, joints=joints, protocol=arm.protocol, rate=200.0, **patient)  # type: ignore[arg-type]


@asynccontextmanager
async def opened(device: Dynamixel) -> AsyncIterator[Dynamixel]:
    await device.open()
    try:
        yield device
    finally:
        await device.make_safe()
        await device.close()


async def read_on(device: Device) -> None:
    """Read until that raises."""
    async with asyncio.timeout(5):
        while True:
            await device.read((await device.read(-1)).sequence)


async def until(device: Device, *wanted: tuple[str, float], within: float = 0.06) -> Sample:
    sample = await device.read(-1)
    async with asyncio.timeout(5):
        while any(abs(float(sample.values[name]) - value) > within for name, value in wanted):
            sample = await device.read(sample.sequence)
    return sample


class TestOnTheBento(DeviceContract):
    @pytest.fixture(autouse=True)
    def _arm(self, bento: EmulatedArm) -> None:
        self._bento = bento

    def make_device(self) -> Device:
        return driver(self._bento)


class TestOnTheMiniBento(DeviceContract):
    @pytest.fixture(autouse=True)
    def _arm(self, mini_bento: EmulatedArm) -> None:
        self._mini_bento = mini_bento

    def make_device(self) -> Device:
        return driver(self._mini_bento, "velocity")


async def test_nothing_moves_before_the_first_command(arm: EmulatedArm) -> None:
    async with opened(driver(arm)) as device:
        await device.read(3)
        assert not any(joint["torque"] for joint in arm.state().values())
        await device.act({"elbow_position": 0.1})
        await device.read((await device.read(-1)).sequence + 1)
        assert {name for name, joint in arm.state().items() if joint["torque"]} == {"elbow"}
        await until(device, ("elbow_position", 0.1))


async def test_a_position_is_sent_within_limits_and_returned_as_sent(mini_bento: EmulatedArm) -> None:
    arm = mini_bento
    async with opened(driver(arm)) as device:
        sent = await device.act({"hand_position": 9.0, "wrist_rotation_position": 0.3})
        assert sent["hand_position"] == pytest.approx(1.5, abs=0.002)
        assert sent["wrist_rotation_position"] == pytest.approx(0.3, abs=0.002)
        await until(device, ("hand_position", 1.5), ("wrist_rotation_position", 0.3))


async def test_a_velocity_goes_to_the_soft_limit_and_zero_stops_there(bento: EmulatedArm) -> None:
    arm = bento
    joints = arm.joints(mode="velocity", low=-1.5, high=0.7)
    async with opened(driver(arm, joints=joints)) as device:
        await device.act({"shoulder_velocity": 2.0})
        await until(device, ("shoulder_position", 0.3))
        sent = await device.act({"shoulder_velocity": 0.001})
        assert sent == {"shoulder_velocity": 0.0}
        stopped = float((await until(device, ("shoulder_velocity", 0.0))).values["shoulder_position"])
        await device.act({"shoulder_velocity": 5.0})
        await until(device, ("shoulder_position", 0.7), within=0.01)
        assert 0.2 < stopped < 0.6


async def test_a_mirrored_joint_turns_the_other_way_round_its_own_zero(bento: EmulatedArm) -> None:
    arm = bento
    joints = arm.joints(mode="velocity", zero=0.2, direction=-1)
    async with opened(driver(arm, joints=joints)) as device:
        before = arm.state()["shoulder"]["position"]
        await device.act({"shoulder_velocity": 3.0})
        sample = await until(device, ("shoulder_position", 0.5))
        after = arm.state()["shoulder"]["position"]
        assert after < before
        assert sample.values["shoulder_position"] == pytest.approx(-(after - 0.2), abs=0.2)


async def test_wheels_and_torque_let_go_when_they_are_made_safe(mini_bento: EmulatedArm) -> None:
    joints = dict(mini_bento.joints())
    joints["hand"] = Joint(id=5, model="XL330-M288", mode="torque", max_load=0.5, torque_rise=1000 * ms)
    joints["shoulder"] = Joint(id=1, model="XL330-M288", mode="wheel", max_acceleration=10.0)
    device = driver(mini_bento, joints=joints, stop="hold")
    async with opened(device):
        sent = await device.act({"hand_torque": 1.0, "shoulder_velocity": 5.0})
        assert 0.0 < float(sent["hand_torque"]) <= 0.11  # what rises in a tenth of a second
        assert 0.0 < float(sent["shoulder_velocity"]) <= 1.1
        await until(device, ("shoulder_velocity", 1.0), within=0.2)
    await asyncio.sleep(0.12)  # it slows down no faster than it is allowed to speed up
    state = mini_bento.state()
    assert state["shoulder"]["torque"]
    assert abs(state["shoulder"]["velocity"]) < 0.05
    assert not state["hand"]["torque"]


@pytest.mark.slow
@pytest.mark.parametrize(("stop", "torque"), [("hold", True), ("release", False)])
async def test_made_safe_it_holds_or_lets_go(arm: EmulatedArm, stop: Any, torque: bool) -> None:
    async with opened(driver(arm, "velocity", stop=stop)) as device:
        await device.act(dict.fromkeys(device.spec.actuators, 1.0))
        await until(device, ("shoulder_position", 0.2))
        await device.make_safe()
        stopped = arm.state()
        await asyncio.sleep(0.25)
        after = arm.state()
    assert {joint["torque"] for joint in (*stopped.values(), *after.values())} == {torque}
    if stop == "hold":
        assert abs(after["shoulder"]["velocity"]) < 0.05
        assert abs(after["elbow"]["position"] - stopped["elbow"]["position"]) < 0.15  # it does not fall
        async with opened(driver(arm)):
            pass


@pytest.mark.slow
async def test_home_is_gone_to_before_it_lets_go(mini_bento: EmulatedArm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_module, "START_SPEED", 4.0)
    arm = mini_bento
    joints = {name: joint for name, joint in arm.joints(start=-0.1).items() if name in WEIGHTLESS}
    device = driver(arm, joints=joints, stop="home")
    async with opened(device):
        await device.begin_episode(RNG)
        sample = await device.read(-1)
        assert all(abs(float(sample.values[f"{name}_position"]) + 0.1) < 0.06 for name in joints)
        await device.act({"shoulder_position": 0.0})
        await until(device, ("shoulder_position", 0.0), within=0.02)
        await device.make_safe()
    assert arm.state()["shoulder"]["position"] == pytest.approx(-0.1, abs=0.06)
    assert not any(joint["torque"] for joint in arm.state().values())


async def test_one_silent_joint_is_flagged_and_the_others_go_on(bento: EmulatedArm) -> None:
    arm = bento
    async with opened(driver(arm, silence=0)) as device:
        arm.fault("silent", 3)
        first = await device.read((await device.read(-1)).sequence + 5)
        last = await device.read(first.sequence + 5)
        fresh = {name: last.values[f"{name}_fresh"] for name in arm.joints()}
        assert fresh == {name: name != "wrist_rotation" for name in fresh}
        sent = await device.act({"shoulder_position": 0.1})
        assert sent["shoulder_position"] == pytest.approx(0.1, abs=0.002)
        arm.mend()
        async with asyncio.timeout(5):
            while not (await device.read((await device.read(-1)).sequence)).values["wrist_rotation_fresh"]:
                pass


async def test_a_joint_that_stays_silent_is_an_error(bento: EmulatedArm) -> None:
    async with opened(driver(bento, silence=50 * ms)) as device:
        bento.fault("silent", 3)
        with pytest.raises(DeviceError, match=r"no answer from wrist_rotation \(id 3\) for 50 ms"):
            await read_on(device)
        bento.mend()


@pytest.mark.parametrize(
    ("robot", "kind", "said"),
    [("bento", "overload", "has been overloaded"), ("mini_bento", "overheat", "is too hot")],
)
async def test_what_a_servo_suffers_ends_the_run(robot: str, kind: str, said: str, tmp_path: Path) -> None:
    with EmulatedArm(tmp_path, robot) as arm:
        device = driver(arm, joints=arm.joints(max_temperature=100.0))
        await device.open()
        arm.fault(kind, 2)
        with pytest.raises(LimitError, match=rf"elbow \(id 2\) {said}"):
            await read_on(device)
        with pytest.raises(LimitError):
            await device.act({"hand_position": 0.0})
        await device.make_safe()
        await device.close()
        with pytest.raises(DeviceError, match=rf"elbow \(id 2\) {said}.*switch its power off"):
            await device.open()


async def test_low_voltage_is_an_error_while_it_lasts(bento: EmulatedArm) -> None:
    async with opened(driver(bento)) as device:
        bento.fault("voltage", 1)
        with pytest.raises(
            DeviceError, match=r"shoulder \(id 1\) has an input voltage beyond its limits"
        ) as raised:
            await read_on(device)
        assert not isinstance(raised.value, LimitError)
        bento.mend()
        await asyncio.sleep(0.05)
        await device.read((await device.read(-1)).sequence)


async def test_a_joint_that_is_not_seen_is_not_switched_on(bento: EmulatedArm) -> None:
    async with opened(driver(bento, silence=0)) as device:
        bento.fault("silent", 5)
        await asyncio.sleep(0.15)
        with pytest.raises(DeviceError, match="hand was not read lately, so that its torque is not switched on"):
            await device.act({"hand_position": 0.1})
        bento.mend()


async def test_servos_that_know_no_group_read_are_read_one_by_one(tmp_path: Path) -> None:
    joints = {"pan": Joint(id=1, model="AX-12A", mode="velocity"), "tilt": Joint(id=7, model="AX-12A")}
    emulated = [{"name": name, "id": joint.id, "model": joint.model} for name, joint in joints.items()]
    with EmulatedArm(tmp_path, "bento", "--joints", json.dumps(emulated)) as arm:
        async with opened(driver(arm, joints=joints, stop="hold")) as device:
            await device.act({"pan_velocity": 2.0, "tilt_position": 0.1})
            await until(device, ("pan_velocity", 2.0), ("tilt_position", 0.1), within=0.1)
        assert {name for name, joint in arm.state().items() if joint["torque"]} == {"pan", "tilt"}


async def test_unplugged_it_says_so_and_can_be_opened_anew(bento: EmulatedArm) -> None:
    arm = bento
    device = driver(arm)
    await device.open()
    arm.fault("unplug", duration="100ms")
    with pytest.raises(DisconnectedError):
        await device.read(1_000_000)
    with pytest.raises(DisconnectedError):
        await device.make_safe()
    async with asyncio.timeout(5):
        while True:
            await device.close()
            try:
                await device.open()
                break
            except DisconnectedError:
                await asyncio.sleep(0.01)
    await device.read(-1)
    await device.make_safe()
    await device.close()


async def test_a_stop_gets_through_once_garbage_has_cleared(arm: EmulatedArm) -> None:
    async with opened(driver(arm, "velocity", silence=0)) as device:
        await device.act({"shoulder_velocity": 0.3})
        arm.fault("babble", duration="100ms")
        await device.make_safe()
        assert not arm.state()["shoulder"]["torque"]


async def test_what_is_not_safe_is_named(bento: EmulatedArm, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = bento
    device = driver(arm)
    monkeypatch.setattr(driver_module, "SAFE_WITHIN", 200 * ms)
    await device.open()
    await device.act({"hand_position": 0.2})
    arm.fault("silent", 4)
    with pytest.raises(DeviceError, match=r"not safe after 180 ms: wrist_flexion \(id 4\)\. Switch"):
        await device.make_safe()
    assert not arm.state()["hand"]["torque"]
    arm.mend()
    await device.close()


async def test_another_model_or_none_is_told_by_name(bento: EmulatedArm) -> None:
    joints = {"elbow": Joint(id=2, model="MX-28"), "tail": Joint(id=9, model="MX-28")}
    with pytest.raises(DeviceError, match=r"no answer from .*tail \(id 9\) at 1000000 baud"):
        await driver(bento, joints=joints).open()
    del joints["tail"]
    with pytest.raises(DeviceError, match=r"elbow \(id 2\) is MX-106, not MX-28: correct its model"):
        await driver(bento, joints=joints).open()


async def test_a_rate_that_the_wire_cannot_carry_is_refused_with_the_arithmetic(bento: EmulatedArm) -> None:
    device = Dynamixel(port=bento.port, joints=bento.joints(), rate=2000.0, return_delay=100_000)
    with pytest.raises(DeviceError, match=r"a round takes 1\.42 ms, which allows 704 Hz, not 2e\+03 Hz"):
        await device.open()
    async with opened(driver(bento, return_delay=0)) as mended:
        assert mended.notes == []


async def test_answers_that_waited_for_a_busy_loop_are_not_missing(bento: EmulatedArm) -> None:
    """The loop is kept busy just after a round was asked for, in a turn in which a timer is due already."""
    async with opened(driver(bento)) as device:
        for _ in range(8):
            await asyncio.sleep(0.003)
            time.sleep(0.012)  # noqa: ASYNC251  # this is what learning on the loop does
            await asyncio.sleep(0)
            await device.act({"hand_position": 0.1})
            time.sleep(0.02)  # noqa: ASYNC251
    missing = device.counters.get("rounds_incomplete", 0)
    assert missing < 4, "only where the emulated bus itself was not let run"


async def test_a_loop_that_stalls_finds_out_that_its_servos_have_stopped(mini_bento: EmulatedArm) -> None:
    device = driver(mini_bento, bus_watchdog=20 * ms)
    assert device.tolerates == 20 * ms
    await device.open()
    await device.act({"hand_position": 0.1})
    time.sleep(0.1)  # noqa: ASYNC251  # this is what a loop that hangs does
    with pytest.raises(LimitError, match="stopped by themselves"):
        await read_on(device)
    await device.make_safe()
    await device.close()


def test_it_can_be_guarded_from_outside(bento: EmulatedArm) -> None:
    device = driver(bento, stop="home", joints=bento.joints(start=0.0))
    assert isinstance(device, Guarded)
    assert isinstance(device, Unhurried)
    assert isinstance(device, Impatient)
    assert device.last_resort().hardware == device.last_resort().settings["port"] == bento.port
    assert device.safe_within > 5000 * ms


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"joints": {}}, "at least one joint"),
        ({"joints": {"a": Joint(1, "MX-28"), "b": Joint(1, "MX-64")}}, "several joints have the id 1"),
        ({"joints": {"a": Joint(1, "MX-82")}}, "there is no model 'MX-82' with protocol 1.0: did you mean 'MX-28'"),
        ({"joints": {"a": Joint(1, "MX-28", "torque")}}, "MX-28 has no mode 'torque'"),
        ({"joints": {"a": Joint(1, "MX-28", low=1.0, high=0.5)}}, "nothing is left between low and high"),
        ({"joints": {"a": Joint(1, "MX-28", low=0.0, start=-1.0)}}, "start is -1 rad, outside its limits 0 to"),
        ({"joints": {"a": Joint(1, "MX-28", "wheel", start=0.0)}}, "goes to no place: leave out start"),
        ({"stop": "home"}, "no joint has a start"),
        ({"rate": 0.0}, "give how often the servos are read"),
        ({"bus_watchdog": 3000 * ms}, "give up to 2.54 s"),
    ],
)
def test_settings_that_cannot_be_are_refused_with_a_sentence(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(SpecError, match=said):
        Dynamixel(**{"port": "/dev/null", "joints": {"a": Joint(1, "MX-28")}, **settings})
