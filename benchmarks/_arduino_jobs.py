"""Arduino boards: the real sketches under simavr, their clocks, what befalls boards and their hosts, and noise."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from random import Random
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from _harness import Row

from rtagent import clock
from rtagent.errors import DeviceError, DisconnectedError
from rtagent.units import ms, second
from rtagent_drivers.arduino import frames, legacy
from rtagent_drivers.arduino.board_clock import BoardClock
from rtagent_drivers.arduino.device import Arduino
from rtagent_drivers.arduino.driver import arduino
from rtagent_drivers.arduino.layouts import HANDI_PINS, HANDI_SERVOS, LAYOUTS
from rtagent_drivers.arduino.messages import Scan
from rtagent_drivers.arduino.settings import Channel, Servo

sys.path.insert(0, str(Path(__file__).parent.parent / "firmware" / "simulator"))
from simulated import Simulated, build

SECONDS, STEPS, KILLS, NOISE, GOOD_EVERY = 30, 100, 10, 1_000_000, 10_000
GLOVE: Mapping[str, Any] = {"channels": {f"A{pin}": Channel() for pin in range(6)}, "rate": 750.0}
HAND: Mapping[str, Any] = {
    "channels": {pin: Channel() for pin in HANDI_PINS.values()},
    "servos": {f"digit{pin}": Servo(pin) for pin in HANDI_SERVOS},
    "rate": 70.0,
}
HEARTBEAT, SEEN, POLLED = 100 * ms, 34 * ms, 5 * ms
"""The board's heartbeat; so long without a pulse the simulator says that there are none; how exact that is."""


def simulated() -> Iterator[Row]:
    """Yield how the glove's sketch does through the driver, for half a minute, and how soon a step is observed."""
    build("glove-uno", "simulator")
    with _folder() as folder, Simulated("glove-uno", folder) as board:
        rate, counters, steps = clock.run(_measured(board), "real")
    yield Row("simulated Uno, 6 channels: scans in a second of its own", rate, "Hz", 750, "higher")
    yield Row(f"scans lost in {SECONDS} s of its own", counters["scans_lost"], "", 0)
    yield Row("frames bad meanwhile", counters["frames_bad"], "", 0)
    yield Row("a step at its converter until it is read from the driver, median", median(steps), "ms", 5)
    yield Row("the same, at most", max(steps), "ms")


async def _measured(board: Simulated) -> tuple[float, Mapping[str, int], list[float]]:
    async with _opened(arduino(port=board.port, **GLOVE)) as device:
        began, first = board.tell("time"), (await device.read(-1)).sequence
        ended = began
        while ended - began < SECONDS * second:
            await device.read((await device.read(-1)).sequence + 500)
            ended, last = board.tell("time"), (await device.read(-1)).sequence
        steps = [await _step(board, device, 1023 * (number % 2)) for number in range(1, STEPS)]
        return (last - first) / ((ended - began) / second), dict(device.counters), steps


async def _step(board: Simulated, device: Arduino, reading: int) -> float:
    """Return how long (ms) it takes until a reading that is injected is observed."""
    await asyncio.sleep(0.0137)
    sequence, began = (await device.read(-1)).sequence, time.perf_counter()
    board.order(f"adc 3 {reading}")
    while True:
        sample = await device.read(sequence)
        sequence = sample.sequence
        if abs(1023 * float(sample.values["A3"]) - reading) < 1:
            return (time.perf_counter() - began) * 1000


def clocks() -> Iterator[Row]:
    """Yield by how much fitted times are wrong while arrivals jitter by 10 ms."""
    for name, jitter in (("each by itself", _independent), ("as the host is busy", _busy), ("in order", _in_order)):
        for drift in (5e-5, -5e-3):
            errors = _fit_errors(jitter, drift)
            label = f"fitted clock, jitter 10 ms {name}, drift {drift * 1e6:g} ppm"
            worst = max(error for taken, error in errors if taken > 5 * second)
            reach = None if jitter is _in_order else 0.2
            yield Row(f"{label}: worst error from 5 s on", worst / ms, "ms", reach)
    wrong = _errors_on_the_wire()
    label = "emulated board, its driver held up by up to 10 ms: errors of sample times"
    yield Row(f"{label}, median", median(wrong), "ms", 0.2)
    yield Row(f"{label}, 99 of 100", wrong[len(wrong) * 99 // 100], "ms", 0.2)


def _fit_errors(jitter: Callable[[Random], Callable[[int], int]], drift: float) -> list[tuple[int, int]]:
    fit, arrival, found = BoardClock(), jitter(Random(1)), []  # noqa: S311  # nothing secret is drawn
    for number in range(750 * 60):
        taken = number * second // 750
        micros = int(taken * (1 + drift)) // 1000 % 2**32
        board = fit.unwrapped(micros)
        fit.hear(board, arrival(taken))
        found.append((taken, abs(fit.at(board) - taken)))
    return found


def _independent(rng: Random) -> Callable[[int], int]:
    return lambda taken: taken + rng.randrange(10 * ms)


def _busy(rng: Random) -> Callable[[int], int]:
    looks = [0]

    def arrival(taken: int) -> int:
        while looks[0] < taken:
            looks[0] += rng.randrange(10 * ms)
        return looks[0]

    return arrival


def _in_order(rng: Random) -> Callable[[int], int]:
    """Each is late by itself, but none overtakes another: hardly any comes in time."""
    last = [0]

    def arrival(taken: int) -> int:
        last[0] = max(last[0], taken + rng.randrange(10 * ms))
        return last[0]

    return arrival


def _errors_on_the_wire() -> list[float]:
    """Return the errors (ms), in order, of the sample times of an emulated board while the loop is often busy."""
    with _folder() as folder, _emulated(folder, "glovi", "--drift", "0.001") as (port, log):
        samples = clock.run(_disturbed(port), "real")
        scans = [entry for line in log.read_text().splitlines() if "scan" in (entry := json.loads(line))]
    begins = max(number for number, entry in enumerate(scans) if entry["scan"] == 0)
    true = {entry["scan"]: entry["time"] for entry in scans[begins:]}
    shift = min(range(-200, 200), key=lambda each: abs(true.get(samples[-1][0] + each, 0) - samples[-1][1]))
    return sorted(abs(true[number + shift] - taken) / ms for number, taken in samples if number + shift in true)


async def _disturbed(port: str) -> list[tuple[int, int]]:
    rng, found = Random(1), []  # noqa: S311
    async with _opened(arduino(port=port, **GLOVE)) as device:
        ends = asyncio.get_running_loop().time() + 15
        while (now := asyncio.get_running_loop().time()) < ends:
            sample = await device.read((await device.read(-1)).sequence)
            if now > ends - 10:
                found.append((sample.sequence, sample.world_time))
            time.sleep(rng.random() * 0.01)  # noqa: ASYNC251  # the loop is to be held up
    return found


def killed() -> Iterator[Row]:
    """Yield when, by the board's own time, no servo gets pulses any more after its host was killed."""
    build("hand-mega", "simulator")
    late = []
    with _folder() as folder, Simulated("hand-mega", folder, ["E5", "E3", "H3", "H6", "B4", "B5"]) as board:
        for _ in range(KILLS):
            host = subprocess.Popen([sys.executable, __file__, board.port], stdout=subprocess.PIPE, text=True)
            assert host.stdout is not None
            host.stdout.readline()
            while not all(board.pulse(pin) for pin in HANDI_SERVOS):
                time.sleep(0.01)
            host.kill()
            host.communicate()
            at = board.tell("time")
            while any(board.pulse(pin) for pin in HANDI_SERVOS):
                time.sleep(0.01)
            late.append(max(each["time"] for each in board.pulses[-6:]) - at - SEEN)
    reach = (HEARTBEAT + POLLED) / ms
    yield Row(f"host killed {KILLS} times: the six servos safe after, at most", max(late) / ms, "ms", reach)


async def _host(port: str) -> None:
    """Move all servos, until this process is killed."""
    device = arduino(port=port, **HAND, heartbeat=HEARTBEAT)
    await device.open()
    await device.act(dict.fromkeys(device.spec.actuators, 1.0))
    print("moving", flush=True)
    await asyncio.Event().wait()


def mishaps() -> Iterator[Row]:
    """Yield whether each mishap is told in a sentence, and recovered from where it can be."""
    for name, mishap in MISHAPS.items():
        with _folder() as folder:
            said, recovered = clock.run(mishap(folder), "real")
        yield Row(f"{name}: told ({said.split(':')[0][:60]})", bool(said), "", 1, "higher")
        if recovered is not None:
            yield Row(f"{name}: recovered from", recovered, "", 1, "higher")


async def _reset(folder: Path) -> tuple[str, bool | None]:
    with _simulated_hand(folder) as board:
        async with _opened(arduino(port=board.port, **HAND)) as device:
            board.tell("reset")
            said = await _until_raises(device)
            sequence = (await device.read(-1)).sequence
            return said, (await device.read(sequence + 20)).sequence > sequence


async def _unplugged(folder: Path) -> tuple[str, bool | None]:
    with _emulated(folder, "handi", "--fault", '{"kind": "unplug", "begin": "1s", "duration": "500ms"}') as (
        port,
        _,
    ):
        device = arduino(port=port, **HAND)
        async with _opened(device):
            said = await _until_raises(device)
        return said, await _opens_again(device)


async def _opens_again(device: Arduino) -> bool:
    for _ in range(200):
        try:
            async with _opened(device):
                return (await device.read(-1)).sequence >= 0
        except DisconnectedError:
            await asyncio.sleep(0.02)
    return False


async def _wrong_sketch(folder: Path) -> tuple[str, bool | None]:
    with _emulated(folder, "glovi") as (port, _):
        return await _said_when_opened(arduino(port=port, **HAND)), None


async def _wrong_baud(folder: Path) -> tuple[str, bool | None]:
    with _emulated(folder, "handi", "--baud", "500kbaud") as (port, _):
        device = arduino(port=port, **HAND)
        said = await _said_when_opened(device)
        return said, await _opens_again(arduino(port=port, baud=500_000, **HAND))


async def _legacy_sketch(folder: Path) -> tuple[str, bool | None]:
    with _emulated(folder, "handi", "--format", "handi", "--baud", "1Mbaud") as (port, _):
        return await _said_when_opened(arduino(port=port, **HAND)), await _opens_again(
            arduino(port=port, format="handi", baud=1_000_000)
        )


MISHAPS: Mapping[str, Callable[[Path], Awaitable[tuple[str, bool | None]]]] = {
    "board reset (simulated Mega)": _reset,
    "unplugged, plugged in": _unplugged,
    "wrong sketch": _wrong_sketch,
    "wrong baud": _wrong_baud,
    "legacy sketch": _legacy_sketch,
}


def noise() -> Iterator[Row]:
    """Yield what a million random bytes do to each decoder, and whether damaged lines are counted and dropped."""
    good = {
        "rtagent": frames.scan((1, 2, 3), 7, 99),
        "handi": legacy.line((0, *range(500, 515)), ","),
        "glovi": legacy.line(range(500, 506), ", "),
        "glovi_binary": legacy.words(range(500, 506)),
    }
    for name, layout in LAYOUTS.items():
        decoder, rng, lost = layout.decoder(), Random(name), 0  # noqa: S311
        scan = [each for each in layout.decoder().feed(b"\0\n" + good[name] * 3) if isinstance(each, Scan)][-1]
        for _ in range(NOISE // GOOD_EVERY):
            decoder.feed(rng.randbytes(GOOD_EVERY))
            decoder.feed(good[name])  # ends what the noise has begun
            lost += scan not in decoder.feed(good[name] * 2)
        label = f"good frames lost after each of {NOISE // GOOD_EVERY} × {GOOD_EVERY} random bytes"
        yield Row(f"{name}: {label}", lost, "", 0)
    yield Row("lines cut, glued, of wrong counts: not counted, or taken for good", _damaged_lines(), "", 0)


def _damaged_lines() -> int:
    rng, decoder, damaged, taken = Random(1), LAYOUTS["handi"].decoder(), 0, 0  # noqa: S311
    decoder.feed(b"\n")
    for _ in range(10_000):
        fields = [str(rng.randrange(2)), *(str(rng.randrange(1024)) for _ in range(15))]
        kind = rng.randrange(4)
        if kind == 0:
            fields = fields[: rng.randrange(1, 16)]
        elif kind == 1:
            fields += fields[: rng.randrange(1, 16)]
        elif kind == 2:
            del fields[rng.randrange(16)]
        damaged += kind < 3
        taken += len(decoder.feed(",".join(fields).encode() + b"\r\n")) != (kind == 3)
    return taken + abs(decoder.bad - damaged)


# Boards


@asynccontextmanager
async def _opened(device: Arduino) -> AsyncIterator[Arduino]:
    await device.open()
    try:
        yield device
    finally:
        await device.close()


async def _said_when_opened(device: Arduino) -> str:
    try:
        async with _opened(device):
            return ""
    except DeviceError as error:
        return str(error)


async def _until_raises(device: Arduino) -> str:
    try:
        async with asyncio.timeout(10):
            while True:
                await device.read((await device.read(-1)).sequence)
    except DeviceError as error:
        return str(error)


def _simulated_hand(folder: Path) -> Simulated:
    build("hand-mega", "simulator")
    return Simulated("hand-mega", folder)


@contextmanager
def _emulated(folder: Path, board: str, *options: str) -> Iterator[tuple[str, Path]]:
    """Give the port and the log of an emulated board."""
    port, log = folder / "board", folder / "log"
    command = [sys.executable, "-m", "rtagent_drivers.arduino.emulated.pty", board, "--link", str(port)]
    emulator = subprocess.Popen(
        [*command, "--log", str(log), *options], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True
    )
    assert emulator.stdout is not None
    emulator.stdout.readline()
    try:
        yield str(port), log
    finally:
        emulator.terminate()
        emulator.communicate()


@contextmanager
def _folder() -> Iterator[Path]:
    with TemporaryDirectory(prefix="rtagent-") as folder:
        yield Path(folder)


if __name__ == "__main__":
    clock.run(_host(sys.argv[1]), "real")
