"""The real sketches, compiled and run under simavr, through the real driver."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from boards import FINGERS, HAND, SERVOS
from simulated import BUTTON_PIN, SERVO_PINS, Simulated, build, missing
from test_arduino_driver import last_resort, opened, until_raises

from rtagent.device import Guarded
from rtagent.errors import DeviceError
from rtagent.experience import Sample
from rtagent.units import ms
from rtagent_drivers.arduino.driver import arduino
from rtagent_drivers.arduino.messages import Scan
from rtagent_drivers.arduino.sampling import Sampler
from rtagent_drivers.arduino.settings import Servo

pytestmark = pytest.mark.slow

HOST = """
import asyncio, sys
from boards import FINGERS, HAND, SERVOS
from rtagent import clock
from rtagent_drivers.arduino.driver import arduino

async def main():
    device = arduino(port=sys.argv[1], channels=HAND, servos=SERVOS, rate=70.0, heartbeat=100_000_000)
    await device.open()
    await device.act({name: 1.0 for name in device.spec.actuators})
    print("moving", flush=True)
    await asyncio.Event().wait()

clock.run(main(), "real")
"""


@pytest.fixture(scope="module")
def built() -> None:
    lacking = missing()
    if lacking and os.environ.get("CI") != "true":
        pytest.skip(f"the sketches cannot be built and run here, as {lacking} is missing: see docs/arduino.md")
    assert not lacking
    build("glove-uno", "hand-mega", "glove-leonardo", "simulator")


@pytest.fixture(scope="module")
def glove(built: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Simulated]:
    with Simulated("glove-uno", tmp_path_factory.mktemp("glove")) as board:
        yield board


@pytest.fixture(scope="module")
def hand(built: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Simulated]:
    with Simulated("hand-mega", tmp_path_factory.mktemp("hand"), list(SERVO_PINS.values())) as board:
        yield board


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(10):
        while not condition():  # noqa: ASYNC110  # what is waited for happens in a thread
            await asyncio.sleep(0.005)


@pytest.fixture
def scans(monkeypatch: pytest.MonkeyPatch) -> list[Scan]:
    """What the driver makes samples of."""
    seen: list[Scan] = []
    take = Sampler.take

    def see(sampler: Sampler, some: Sequence[Scan], arrival: int) -> Sample:
        seen.extend(some)
        return take(sampler, some, arrival)

    monkeypatch.setattr(Sampler, "take", see)
    return seen


def period(scans: Sequence[Scan]) -> float:
    """Return the mean time (µs) between scans by the board's own clock; each is there."""
    numbers = [scan.number for scan in scans]
    assert None not in numbers
    assert numbers == [number % 65536 for number in range(numbers[0] or 0, (numbers[0] or 0) + len(numbers))]
    first, last = scans[0].micros, scans[-1].micros
    assert first is not None
    assert last is not None
    return (last - first) / (len(scans) - 1)


async def test_750_scans_of_6_channels_in_a_second_of_the_board_and_none_is_lost(
    glove: Simulated, scans: list[Scan]
) -> None:
    async with opened(arduino(port=glove.port, channels=FINGERS, rate=750.0)) as device:
        await device.read((await device.read(-1)).sequence + 700)
        assert period(scans) == pytest.approx(1333, abs=0.5)
        assert not any(device.counters.values()), device.counters


async def test_a_step_of_an_input_is_in_one_of_the_next_samples(glove: Simulated) -> None:
    async with opened(arduino(port=glove.port, channels=FINGERS, rate=750.0)) as device:
        for number in range(6):
            glove.tell(f"adc {number} {100 * number + 23}")
        before = (await device.read(-1)).sequence
        sample = await device.read(before + 20)
        read = [round(1023 * float(sample.values[name])) for name in FINGERS]
        assert read == [100 * number + 23 for number in range(6)]


async def test_a_sketch_keeps_its_rate_up_to_its_limit_and_tells_it(glove: Simulated, scans: list[Scan]) -> None:
    async with opened(arduino(port=glove.port, channels=FINGERS, rate=1500.0)) as device:
        await device.read((await device.read(-1)).sequence + 600)
        assert period(scans) == pytest.approx(667, abs=1)
        assert not any(device.counters.values()), device.counters
    with pytest.raises(DeviceError, match="6 channels, but is to measure them every 500 µs"):
        await arduino(port=glove.port, channels=FINGERS, rate=2000.0).open()


async def test_all_channels_of_the_hand_are_told_apart(hand: Simulated) -> None:
    async with opened(arduino(port=hand.port, channels=HAND, servos=SERVOS, rate=200.0)) as device:
        pins = {name: int(channel.pin[1:]) for name, channel in HAND.items() if channel.pin[0] == "A"}
        for number in pins.values():
            hand.tell(f"adc {number} {60 * number + 7}")
        hand.tell(f"pin {BUTTON_PIN} 0")
        sample = await device.read((await device.read(-1)).sequence + 20)
        assert {name: round(1023 * float(sample.values[name])) for name in pins} == {
            name: 60 * number + 7 for name, number in pins.items()
        }
        assert sample.values["m"] is True, "pressed, the button pulls its pin down"


async def test_servos_get_the_pulses_that_were_commanded_until_they_are_made_safe(hand: Simulated) -> None:
    async with opened(arduino(port=hand.port, channels=HAND, servos=SERVOS, rate=70.0)) as device:
        goals = {name: 0.4 * number + 0.2 for number, name in enumerate(SERVOS)}
        await device.act({f"{name}_position": goal for name, goal in goals.items()})
        await until(lambda: all(hand.pulse(servo.pin) > 0 for servo in SERVOS.values()))
        for name, servo in SERVOS.items():
            assert hand.pulse(servo.pin) == pytest.approx(servo.pulse(goals[name]), abs=12)
        await device.make_safe()
        await until(lambda: not any(hand.pulse(servo.pin) for servo in SERVOS.values()))


async def test_held_servos_go_on_getting_their_pulses(hand: Simulated) -> None:
    servo = {"digit": Servo(10)}
    device = arduino(port=hand.port, channels=HAND, servos=servo, rate=70.0, stop="hold", heartbeat=50 * ms)
    async with opened(device):
        await device.act({"digit_position": 1.0})
        await until(lambda: hand.pulse(10) > 0)
        await device.make_safe()
        since = hand.tell("time")
        await until(lambda: hand.tell("time") > since + 150 * ms)
        assert hand.pulse(10) > 0
    hand.tell("reset")
    await until(lambda: hand.pulse(10) == 0)


async def test_a_board_that_is_reset_is_told_and_goes_on(hand: Simulated) -> None:
    async with opened(arduino(port=hand.port, channels=HAND, servos=SERVOS, rate=100.0)) as device:
        hand.tell("reset")
        assert "was reset" in await until_raises(device)
        sequence = (await device.read(-1)).sequence
        assert (await device.read(sequence + 10)).sequence > sequence


async def test_the_last_resort_makes_the_servos_safe(hand: Simulated) -> None:
    device = arduino(port=hand.port, channels=HAND, servos=SERVOS, rate=70.0)
    assert isinstance(device, Guarded)
    async with opened(device):
        await device.act({"digit0_position": 1.0})
        await until(lambda: hand.pulse(3) > 0)
        resort = last_resort(device)
        assert resort.make_safe() == []
        resort.close()
        await until(lambda: hand.pulse(3) == 0)


async def test_the_servos_are_safe_within_the_heartbeat_of_a_host_that_is_killed(hand: Simulated) -> None:
    host = subprocess.Popen(  # noqa: ASYNC220  # nothing else waits meanwhile
        [sys.executable, "-c", HOST, hand.port], stdout=subprocess.PIPE, cwd=Path(__file__).parent, text=True
    )
    assert host.stdout is not None
    assert host.stdout.readline() == "moving\n"
    await until(lambda: all(hand.pulse(servo.pin) > 0 for servo in SERVOS.values()))
    host.kill()
    host.communicate()
    killed = hand.tell("time")
    await until(lambda: not any(hand.pulse(servo.pin) for servo in SERVOS.values()))
    seen = 34 * ms  # so long without a pulse, and there are none
    assert all(each["time"] - killed < 100 * ms + seen + 5 * ms for each in hand.pulses[-6:])
