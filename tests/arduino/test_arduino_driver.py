"""The driver on emulated boards: our format and older ones, and what goes wrong with boards and their lines."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import FINGERS, HAND, SERVOS, Board

from rtagent.device import Device, Guarded, Impatient
from rtagent.errors import DeviceError, DisconnectedError
from rtagent.testing import DeviceContract
from rtagent.units import ms, us
from rtagent.watchdog.resorts import Resort
from rtagent_drivers.arduino.device import Arduino
from rtagent_drivers.arduino.driver import arduino
from rtagent_drivers.arduino.layouts import HANDI_SERVOS
from rtagent_drivers.arduino.settings import Channel, Servo

CHECKS = [name for name in vars(DeviceContract) if name.startswith("test_")]
LEGACY_SERVOS = {f"digit{pin}": Servo(pin, start=1.0) for pin in HANDI_SERVOS}


def glove_driver(port: str, **settings: Any) -> Arduino:
    return arduino(**{"port": port, "channels": FINGERS, "rate": 500.0, **settings})


def hand_driver(port: str, **settings: Any) -> Arduino:
    return arduino(**{"port": port, "channels": HAND, "servos": SERVOS, "rate": 200.0, **settings})


def legacy_driver(port: str, **settings: Any) -> Arduino:
    return arduino(**{"port": port, "format": "handi", "servos": LEGACY_SERVOS, "stop": "hold", **settings})


@pytest.fixture(scope="module")
def glove(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Board]:
    with Board(tmp_path_factory.mktemp("glove")) as board:
        yield board


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Board]:
    with Board(tmp_path_factory.mktemp("hand"), "handi") as board:
        yield board


@pytest.fixture(scope="module")
def legacy_hand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Board]:
    with Board(tmp_path_factory.mktemp("legacy"), "handi", "--format", "handi", "--rate", "200Hz") as board:
        yield board


DRIVERS: dict[str, Callable[..., Arduino]] = {
    "glove": glove_driver,
    "hand": hand_driver,
    "legacy_hand": legacy_driver,
}


@asynccontextmanager
async def opened(device: Arduino) -> AsyncIterator[Arduino]:
    await device.open()
    try:
        yield device
    finally:
        await device.close()


async def until_raises(device: Arduino) -> str:
    """Read until something is raised; return what it says."""
    async with asyncio.timeout(5):
        while True:
            try:
                await device.read((await device.read(-1)).sequence)
            except DeviceError as error:
                return str(error)


async def until(condition: Callable[[], bool], device: Arduino) -> None:
    """Read until something is so."""
    async with asyncio.timeout(10):
        while not condition():
            await device.read((await device.read(-1)).sequence + 3)


def last_reset(board: Board) -> int:
    """Return which scan was the first one after the last reset."""
    return max(at for at, entry in enumerate(board.log("scan")) if entry["scan"] == 0)


def periods(board: Board, since: int = -10) -> list[int]:
    """Return the times (ns) between scans, by the board itself."""
    times = [entry["time"] for entry in board.log("scan")[since:]]
    return [int(period) // us * us for period in np.diff(times)]


def last_resort(device: Guarded) -> Resort:
    told = device.last_resort()
    return Resort("hand", told.function, told.settings)


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("name", DRIVERS)
def test_the_driver_keeps_the_contract(name: str, check: str, request: pytest.FixtureRequest) -> None:
    board: Board = request.getfixturevalue(name)
    suite = DeviceContract()
    suite.make_device = lambda: DRIVERS[name](board.port)  # type: ignore[method-assign]
    getattr(suite, check)()


# Measuring


async def test_samples_have_the_boards_times_and_none_is_lost(glove: Board) -> None:
    async with opened(glove_driver(glove.port, rate=750.0)) as device:
        first = last = await device.read(-1)
        for _ in range(200):
            sample = await device.read(last.sequence)
            assert sample.time_source == "device"
            assert last.world_time <= sample.world_time <= sample.arrival_time
            last = sample
        assert last.sequence - first.sequence >= 200
        assert not any(device.counters.values()), device.counters
        assert periods(glove)[-1] == 1333 * us


async def test_what_is_read_at_a_pin_is_in_the_sample(hand: Board) -> None:
    channels = {**HAND, "angle": Channel("A11", low=-1.0, high=1.0, unit="rad")}
    del channels["fsr1"]
    async with opened(hand_driver(hand.port, channels=channels)) as device:
        for pin, reading in (("A11", 1023), ("2", 0)):
            hand.tell("set", pin=pin, reading=reading)
        sample = await device.read((await device.read(-1)).sequence + 2)
        assert sample.values["angle"] == 1.0
        assert sample.values["m"] is True


async def check_older_sketch(board: Board, name: str, pin: str) -> None:
    board.tell("set", pin=pin, reading=777)
    async with opened(arduino(port=board.port, format=name)) as device:  # type: ignore[arg-type]
        sample = await device.read(2)
        assert sample.values[pin] == pytest.approx(777 / 1023)
        assert sample.time_source == "arrival"
        assert device.counters["frames_bad"] == 0
        board.fault("corrupt", probability=0.3)
        await device.read(sample.sequence + 30)
        board.tell("mend")
        assert device.counters["frames_bad"] > 0 or name == "glovi_binary", "words have no check"


async def test_the_older_sketch_of_the_hand_is_read(legacy_hand: Board) -> None:
    await check_older_sketch(legacy_hand, "handi", "FSR5")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glovi", "glovi_binary"])
async def test_the_older_sketches_of_the_glove_are_read(name: str, tmp_path: Path) -> None:
    with Board(tmp_path, "glovi", "--format", name, "--rate", "300Hz") as board:
        await check_older_sketch(board, name, "A5")


async def test_damaged_and_lost_frames_are_counted_and_the_rest_goes_on(glove: Board) -> None:
    async with opened(glove_driver(glove.port)) as device:
        for kind in ("corrupt", "cut", "noise", "silent"):
            glove.fault(kind, probability=0.1)
        first = await device.read(-1)
        last = await device.read(first.sequence + 200)
        glove.tell("mend")
        assert last.sequence - first.sequence >= 200
        assert device.counters["scans_lost"] > 20
        assert device.counters["frames_bad"] > 20


# What is told in a sentence


async def said_when_opened(device: Arduino) -> str:
    with pytest.raises(DeviceError) as caught:
        await device.open()
    return str(caught.value)


async def test_a_board_of_another_sketch_is_told(
    glove: Board, legacy_hand: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rtagent_drivers.arduino.opening.PATIENCE", 300 * ms)
    assert "no servos on 3, 5, 6, 9, 10, 11; it has none" in await said_when_opened(
        arduino(port=glove.port, channels=FINGERS, servos=SERVOS)
    )
    said = await said_when_opened(arduino(port=glove.port, channels={"x": Channel("A9")}))
    assert "no channels on A9; it has A0, A1, A2, A3, A4, A5" in said
    said = await said_when_opened(glove_driver(glove.port, rate=4500.0, baud="usb"))
    assert "takes 606 µs for its 6 channels, but is to measure them every 222 µs: lower the rate" in said
    said = await said_when_opened(glove_driver(glove.port, rate=4500.0, channels={"x": Channel("A1")}))
    assert "the board sends all its channels: 6 channels at 4500 Hz are 23 bytes × 10 bits" in said
    said = await said_when_opened(arduino(port=legacy_hand.port, channels=FINGERS, baud=None))
    assert "make no sense" in said, "at its own baud rate it would be known"
    assert 'set format = "rtagent"' in await said_when_opened(
        arduino(port=glove.port, format="glovi", baud=1_000_000)
    )


async def test_an_older_sketch_is_known_by_what_it_says(legacy_hand: Board) -> None:
    said = await said_when_opened(arduino(port=legacy_hand.port, format="glovi"))
    assert "speaks the format 'handi', not 'glovi': set format = \"handi\", or upload its sketch" in said


@pytest.mark.slow
async def test_a_board_that_says_nothing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rtagent_drivers.arduino.opening.PATIENCE", 200 * ms)
    with Board(tmp_path, "glovi", "--fault", '{"kind": "silent"}') as board:
        assert "nothing came from the board" in await said_when_opened(glove_driver(board.port))
    with pytest.raises(DisconnectedError, match="there is no port"):
        await glove_driver(str(tmp_path / "nothing")).open()


async def test_a_board_that_is_reset_by_opening_its_port_is_waited_for(tmp_path: Path) -> None:
    with Board(tmp_path, "glovi", "--auto-reset", "--boot", "150ms") as board:
        began = time.monotonic()
        async with opened(glove_driver(board.port)) as device:
            assert time.monotonic() - began > 0.14
            assert device.counters["frames_bad"] == 0
            assert device.counters["board_resets"] == 0


async def test_a_reset_is_told_once_and_measuring_goes_on_as_before(hand: Board) -> None:
    async with opened(hand_driver(hand.port)) as device:
        last = await device.read(-1)
        hand.tell("reset")
        assert "was reset, and its servos have gone limp" in await until_raises(device)
        assert (await device.read(last.sequence + 10)).sequence > last.sequence
        await until(lambda: periods(hand)[-1] == 5 * ms, device)
        assert device.counters["board_resets"] == 1


async def test_a_board_that_did_not_hear_its_settings_after_a_reset_is_told_them_again(glove: Board) -> None:
    async with opened(glove_driver(glove.port)) as device:
        glove.fault("deaf", duration="50ms")
        glove.tell("reset")
        await until_raises(device)
        await until(lambda: periods(glove)[-1] == 2 * ms, device)
        last = await device.read((await device.read(-1)).sequence + 5)
        assert periods(glove, last_reset(glove))[0] == 1333 * us, "as the sketch has it"
        assert device.counters["scans_lost"] == 0, "its numbers go on"
        assert last.sequence > 0


async def test_unplugged_it_is_disconnected_and_plugged_in_it_goes_on(glove: Board) -> None:
    device = glove_driver(glove.port)
    async with opened(device):
        sequence = (await device.read(-1)).sequence
        glove.fault("unplug", duration="100ms")
        assert "plug its adapter in again" in await until_raises(device)
    async with asyncio.timeout(5):
        while True:
            try:
                await device.open()
                break
            except DisconnectedError:
                await asyncio.sleep(0.01)
    assert (await device.read(-1)).sequence > sequence
    await device.close()


# Servos


def pulses(board: Board, pin: int) -> list[int]:
    return [entry["pulse"] for entry in board.log("servo") if entry["servo"] == pin]


async def test_a_command_is_a_pulse_and_what_was_sent_is_within_limits(hand: Board) -> None:
    servos = {**SERVOS, "digit0": Servo(3, low=0.5, high=2.5, start=1.0, max_velocity=10.0)}
    async with opened(hand_driver(hand.port, servos=servos)) as device:
        assert await device.act({"digit0_position": 9.0}) == {"digit0_position": 2.5}
        while pulses(hand, 3)[-1:] != [servos["digit0"].pulse(2.5)]:
            await device.read((await device.read(-1)).sequence)
        steps = np.diff([pulse for pulse in pulses(hand, 3) if pulse])
        begun = pulses(hand, 3).index(servos["digit0"].pulse(1.0))
        assert (steps[begun:] > 0).all()
        await device.make_safe()
        assert pulses(hand, 3)[-1] == 0


async def test_holding_is_to_stay_on_the_way(hand: Board) -> None:
    servos = {"digit1": Servo(5, start=0.0, max_velocity=1.0)}
    async with opened(hand_driver(hand.port, servos=servos, stop="hold")) as device:
        await device.act({"digit1_position": 3.0})
        await asyncio.sleep(0.1)
        await device.make_safe()
        held = pulses(hand, 5)
        await asyncio.sleep(0.1)
        assert pulses(hand, 5) == held
        assert 0 < held[-1] < servos["digit1"].pulse(0.5)
        hand.tell("reset")


async def test_a_host_that_is_silent_has_the_board_make_its_servos_safe(hand: Board) -> None:
    async with opened(hand_driver(hand.port, heartbeat=150 * ms)) as device:
        assert isinstance(device, Impatient)
        assert device.tolerates == 150 * ms
        await device.act({"digit2_position": 1.0})
        await asyncio.sleep(0.3)
        assert pulses(hand, 6)[-1] > 0, "it is spoken to, though nothing is commanded"
        time.sleep(0.25)  # noqa: ASYNC251  # what must not happen, happens
        assert "heard nothing for 150 ms" in await until_raises(device)
        assert pulses(hand, 6)[-1] == 0
        assert device.counters["heartbeats_missed"] == 1
        await asyncio.sleep(0.03)
        assert pulses(hand, 6)[-1] == 0, "it does not move again by itself"
        await device.act({"digit2_position": 1.0})
        await device.read((await device.read(-1)).sequence + 2)
        assert pulses(hand, 6)[-1] > 0


async def test_it_is_made_safe_by_another_process_and_knows_it(hand: Board) -> None:
    device = hand_driver(hand.port)
    assert isinstance(device, Guarded)
    async with opened(device):
        await device.act({"digit3_position": 1.0})
        await device.read((await device.read(-1)).sequence + 2)
        resort = last_resort(device)
        assert resort.make_safe() == []  # the event loop stands still meanwhile
        resort.close()
        assert pulses(hand, 9)[-1] == 0
        assert "has made its servos safe" in await until_raises(device)


async def test_the_last_resort_tells_what_it_could_not_reach(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rtagent_drivers.arduino.last_resort.WITHIN", 0.1)
    device = hand_driver(str(tmp_path / "nothing"))
    assert isinstance(device, Guarded)
    (said,) = last_resort(device).make_safe()
    assert "did not confirm that its servos are safe" in said
    assert "switch their power off" in said


async def test_a_legacy_hand_is_sent_to_positions(legacy_hand: Board) -> None:
    async with opened(legacy_driver(legacy_hand.port)) as device:
        sent = await device.act({"digit3_position": np.pi})
        assert sent == {"digit3_position": np.pi}
        await device.read((await device.read(-1)).sequence + 2)
        assert pulses(legacy_hand, 3)[-1] == 2400
        assert pulses(legacy_hand, 11)[-1] == round(544 + 1856 * 57 / 180)
        await device.make_safe()


def test_a_glove_has_nothing_to_be_guarded() -> None:
    device: Device = glove_driver("x")
    assert not isinstance(device, Guarded)
    assert not isinstance(device, Impatient)
