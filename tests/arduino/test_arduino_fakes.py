"""The fakes of boards: as worlds under both clocks, and as the driver on an emulated board."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from boards import FINGERS, HAND, SERVOS
from parts import SCENARIOS
from test_arduino_driver import CHECKS, opened, until_raises

from rtagent import clock
from rtagent.clock import ClockName, current
from rtagent.device import Device, Guarded
from rtagent.errors import SpecError
from rtagent.scenario import assemble, load
from rtagent.testing import DeviceContract
from rtagent.units import ms, second
from rtagent_drivers.arduino.bodies import BODIES, CONTACT, LEAST, MOST, Hand
from rtagent_drivers.arduino.driver import arduino
from rtagent_drivers.arduino.fakes import EmulatedArduinoWithServos, in_process, on_wire
from rtagent_drivers.arduino.settings import Channel, FakeSettings, Servo

SETTINGS: dict[str, dict[str, Any]] = {
    "glove": {"port": "x", "channels": FINGERS, "rate": 750.0},
    "hand": {"port": "x", "channels": HAND, "servos": SERVOS, "rate": 200.0},
    "legacy glove": {"port": "x", "format": "glovi"},
}


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize(
    ("name", "clock_name"),
    [(name, "virtual") for name in SETTINGS] + [("glove", "real"), ("hand", "real")],
)
def test_boards_in_the_process_keep_the_contract(name: str, clock_name: ClockName, check: str) -> None:
    suite = DeviceContract()
    suite.clock = clock_name
    suite.make_device = lambda: in_process(**SETTINGS[name])  # type: ignore[method-assign]
    getattr(suite, check)()


def test_the_driver_names_its_fakes() -> None:
    fakes = arduino.fakes  # type: ignore[attr-defined]  # --fake looks for it
    assert type(fakes["process"](**SETTINGS["glove"])) is type(in_process(**SETTINGS["glove"]))
    assert type(fakes["wire"](**SETTINGS["hand"])) is type(on_wire(**SETTINGS["hand"]))
    for level in fakes.values():
        with pytest.raises(SpecError, match="is no pin"):
            level(port="x", channels={"x": Channel("B1")})


async def test_a_board_on_the_wire_begins_with_its_driver_and_takes_orders() -> None:
    wire = ('{"kind": "corrupt", "probability": 0.1}',)
    device = on_wire(**SETTINGS["hand"], fake=FakeSettings(wire=wire, drift=0.001))
    assert isinstance(device, EmulatedArduinoWithServos)
    assert isinstance(device, Guarded)
    async with opened(device):
        assert device.last_resort().hardware == "", "it stays not latched"
        assert device.last_resort().settings["port"] == str(device.emulation.link)
        device.emulation.tell(do="reset")
        assert "was reset" in await until_raises(device)


async def moved(device: Device, signal: str, wait: int) -> float:
    await current().sleep_until(current().now() + wait)
    return float((await device.read(-1)).values[signal])


def test_joints_follow_their_servos_in_their_own_time_and_stay_where_they_are_let_go() -> None:
    async def check() -> None:
        servo = {"digit": Servo(9, start=0.0, max_velocity=np.pi / 2)}
        device = in_process(**{**SETTINGS["hand"], "channels": {"joint": Channel("A2")}, "servos": servo})
        await device.open()
        await device.begin_episode(np.random.default_rng(1))
        lowest, span = LEAST / 1023, (MOST - LEAST) / 1023
        await device.act({"digit_position": np.pi / 2})
        assert await moved(device, "joint", 500 * ms) == pytest.approx(lowest + span * 0.25, abs=0.01)
        await device.make_safe()
        assert await moved(device, "joint", 500 * ms) == pytest.approx(lowest + span * 0.25, abs=0.01)

    clock.run(check(), "virtual")


def test_a_finger_that_meets_an_object_presses_on_it() -> None:
    hand = Hand()
    hand.begin(0, np.random.default_rng(1))
    hand.turn(0, 1, 1.0)
    times = range(2 * second, 40 * second, 100 * ms)
    pressing = [hand.reading("FSR1", time) > 100 for time in times]
    blocked = [hand.reading("D1P", time) < LEAST + (MOST - LEAST) * (CONTACT + 0.1) for time in times]
    assert pressing == blocked
    assert 0 < sum(pressing) < len(pressing)


def test_bodies_are_functions_of_time_that_their_seed_decides() -> None:
    for body in (BODIES["grasping"](), BODIES["glove"]()):
        readings = []
        for seed in (1, 1, 2):
            body.begin(0, np.random.default_rng(seed))
            times = np.random.default_rng(seed).permutation(50) * 200 * ms
            found = {int(time): [body.reading(f"A{pin}", int(time)) for pin in range(16)] for time in times}
            readings.append([found[time] for time in sorted(found)])
        assert readings[0] == readings[1] != readings[2]
        assert np.min(readings) >= 0
        assert np.max(readings) <= 1023


def test_hand_and_glove_are_observed_together_by_their_newest_samples() -> None:
    path = SCENARIOS / "grasp_recording.toml"
    faked = ["run.fake=process", "run.clock=virtual", "run.episode_time=2s"]
    assembly = assemble(load(path, faked))
    result = clock.run(assembly.run(), "virtual")
    assert result.episodes[0].steps == pytest.approx(140, abs=2)
    assert len(assembly.devices) >= 2


@pytest.mark.slow
def test_hand_and_glove_are_observed_together_on_the_wire() -> None:
    path = SCENARIOS / "grasp_recording.toml"
    assembly = assemble(load(path, ["run.fake=wire", "run.episode_time=500ms"]))
    result = clock.run(assembly.run(), "real")
    assert result.episodes[0].steps > 20
