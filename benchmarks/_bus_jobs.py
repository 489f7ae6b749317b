"""The Dynamixel driver on emulated arms: how fast it reads, how it disturbs the loop, and what faults cost."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Coroutine, Iterator
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import Any

from _harness import Row

from rtagent import clock
from rtagent.guard import HangGuard
from rtagent.latch import Latch
from rtagent.supervision import SupervisedDevice, Supervision
from rtagent.units import ms, second
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.emulated.robots import BENTO
from rtagent_drivers.dynamixel.orders import questions, state_span
from rtagent_drivers.dynamixel.settings import Joint, Mode, find_model
from rtagent_drivers.dynamixel.timing import transaction

BAUD = 1_000_000
WINDOW, WINDOWS = 0.2, 30
PACED = 50.0
STOPS = 10


class Emulated:
    """An emulated Bento Arm in a process of its own."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.port, self.log = str(folder / "arm"), folder / "log"
        command = [sys.executable, "-m", "rtagent_drivers.dynamixel.emulated.pty", "bento", "--link", self.port]
        command += ["--linger", "0ms"]  # it ends with this process, however that ends
        pipe = subprocess.PIPE
        self._process = subprocess.Popen([*command, *arguments], stdin=pipe, stdout=pipe, text=True)
        self._out().readline()

    @property
    def plugged(self) -> bool:
        """Whether its port is there."""
        return Path(self.port).exists()

    def tell(self, **order: Any) -> None:
        """Give an order, and wait until it is carried out."""
        assert self._process.stdin is not None
        self._process.stdin.write(f'{json.dumps(order)}\n{{"do": "tell"}}\n')
        self._process.stdin.flush()
        self._out().readline()

    def events(self) -> list[dict[str, Any]]:
        """Return what the log holds."""
        return [json.loads(line) for line in self.log.read_text().splitlines()]

    def _out(self) -> Any:
        assert self._process.stdout is not None
        return self._process.stdout

    def end(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.communicate(timeout=10)


@contextlib.contextmanager
def emulated(*arguments: str) -> Iterator[Emulated]:
    """Give an emulated arm that writes a log."""
    with tempfile.TemporaryDirectory() as folder:
        with priority():
            arm = Emulated(Path(folder), "--log", str(Path(folder, "log")), *arguments)
        try:
            yield arm
        finally:
            arm.end()


def driver(arm: Emulated, rate: float, mode: Mode = "position") -> Dynamixel:
    """Return the driver of an emulated arm; a joint may be silent for ever."""
    joints = {each.name: Joint(id=each.id, model=each.model, mode=mode) for each in BENTO}
    return Dynamixel(port=arm.port, joints=joints, rate=rate, silence=0)


def run(use: Callable[[Emulated], Coroutine[Any, Any, list[Row]]], *arguments: str) -> list[Row]:
    """Return the rows of a job that uses an emulated arm."""
    with emulated(*arguments) as arm:
        return clock.run(use(arm))


@contextlib.contextmanager
def priority() -> Iterator[None]:
    """Run before other programs, the emulated arm too, where that is allowed: a true bus is nobody's program."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def bus_rows() -> list[Row]:
    """Return all rows of this file."""
    with priority():
        rows = run(_rate, "--timing", "true")
    rows += run(_lateness)
    rows += run(_one_silent)
    rows += run(_replug)
    return rows + run(_stop_in_garbage)


def theoretical_rate() -> float:
    """Return how many rounds of reading five servos a second the wire allows, without any delay between them."""
    spans = [state_span(find_model(each.model, 1), each.id) for each in BENTO]
    asked = questions(codec(1), spans, [])[0]
    return second / transaction(len(asked.data), asked.lengths, BAUD, 0)


async def _rate(arm: Emulated) -> list[Row]:
    theory = theoretical_rate()
    device = driver(arm, theory)
    await device.open()
    rates = [await _samples(device, WINDOW) / WINDOW for _ in range(WINDOWS)]
    await device.close()
    return [
        Row("rounds of 5 servos at 1 Mbaud, as the wire allows", theory, "Hz"),
        Row(f"rounds reached (median of {WINDOWS} times {WINDOW} s)", median(rates), "Hz"),
        Row("rounds reached (the best: other programs only slow it)", max(rates) / theory, "", 0.9, "higher"),
    ]


async def _samples(device: Dynamixel, duration: float) -> int:
    loop = asyncio.get_running_loop()
    sample = await device.read(-1)
    first, ends = sample.sequence, loop.time() + duration
    while loop.time() < ends:
        sample = await device.read(sample.sequence)
    return sample.sequence - first


async def _lateness(arm: Emulated) -> list[Row]:
    """Measure how late the loop is woken: idle, with a silent bus, and with the SDK on a silent bus in a thread."""
    device, processors = driver(arm, PACED), os.sched_getaffinity(0)
    idle, ours, idle_again, sdk = [], [], [], []
    os.sched_setaffinity(0, {max(processors)})  # so that a thread that spins has to share it with the loop
    for _ in range(5):
        arm.tell(do="mend")
        with priority():
            idle.append(await _late())
            await device.open()
            arm.tell(do="fault", kind="silent")
            ours.append(await _late())
            await device.close()
        idle_again.append(await _late())
        with _sdk_asks(arm.port):  # with a priority it would never let go of the processor
            sdk.append(await _late())
    os.sched_setaffinity(0, processors)
    return [
        Row("wake-up error of an idle loop", median(idle) * 1e6, "µs"),
        Row("the same with the driver on a silent bus, times idle", _ratio(ours, idle), "", 1.2),
        Row("the same with the SDK in a thread, times idle", _ratio(sdk, idle_again), ""),
    ]


def _ratio(these: list[float], those: list[float]) -> float:
    return median(this / that for this, that in zip(these, those, strict=True))


async def _late() -> float:
    """Return how late (s) a sleep of 1 ms ends, on average over a second."""
    loop = asyncio.get_running_loop()
    late = []
    for _ in range(500):
        due = loop.time() + 0.001
        await asyncio.sleep(0.001)
        late.append(loop.time() - due)
    return fmean(late)


@contextlib.contextmanager
def _sdk_asks(port: str) -> Iterator[None]:
    """Let the servos' own library ask again and again, in a thread."""
    from dynamixel_sdk import PacketHandler, PortHandler

    handler, packets, over = PortHandler(port), PacketHandler(1.0), threading.Event()
    handler.openPort()
    handler.setBaudRate(BAUD)

    def ask() -> None:
        while not over.is_set():
            packets.read2ByteTxRx(handler, 1, 36)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        handler.closePort()


async def _one_silent(arm: Emulated) -> list[Row]:
    device = driver(arm, PACED)
    await device.open()
    before = await _samples(device, 2.0)
    arm.tell(do="fault", kind="silent", servo=3)
    after = await _samples(device, 4.0) / 2
    await device.close()
    return [
        Row(f"rounds of the other four with one silent servo at {PACED:.0f} Hz", after / before, "", 0.95, "higher")
    ]


async def _replug(arm: Emulated) -> list[Row]:
    """Measure how long after its port is there again an arm is read again, as the runtime does it."""
    guard = HangGuard(clock.current())
    watched = Supervision(timeout=5 * second)
    arm_device, latch = driver(arm, PACED), Latch()
    device = SupervisedDevice(
        "arm", arm_device, watched, clock.current(), guard, latch, lambda name, said: None, _nothing
    )
    await device.open()
    times = []
    for _ in range(STOPS):
        arm.tell(do="fault", kind="unplug", duration="300ms")
        while arm.plugged:
            await _look(device)
        while not arm.plugged:
            await _look(device)
        back = clock.current().now()
        while device.sample is None or device.sample.world_time < back:
            await _look(device)
        times.append((clock.current().now() - back) / ms)
    await device.make_safe()
    await device.device.close()
    guard.close()
    return [Row(f"from the port's return to the next sample (worst of {STOPS})", max(times), "ms", 1000.0)]


async def _nothing() -> None:
    """Do nothing: nobody else has to know that the arm was opened anew."""


async def _look(device: SupervisedDevice) -> None:
    await device.read(device.sequence, 20 * ms)
    await asyncio.sleep(0.0005)


async def _stop_in_garbage(arm: Emulated) -> list[Row]:
    """Measure how long after garbage has cleared the last torque goes off, in periods of the bus."""
    device = driver(arm, PACED, "velocity")
    for _ in range(STOPS):
        await device.open()
        await device.act({"shoulder_velocity": 0.2})
        await asyncio.sleep(0.05)
        arm.tell(do="fault", kind="babble", duration="200ms")
        await device.make_safe()
        await device.close()
    events = arm.events()
    cleared = [each["time"] for each in events if each["event"] == "mended"]
    off = [each["time"] for each in events if each["event"] == "torque_enable" and not each["value"]]
    took = [
        max(time for time in off if start <= time < following) - start
        for start, following in pairwise([*cleared, 2 * cleared[-1]])
    ]
    assert len(took) == STOPS
    return [
        Row(
            f"torque off after garbage has cleared, in periods (worst of {STOPS})",
            max(took) * PACED / second,
            "",
            3.0,
        )
    ]


if __name__ == "__main__":
    from _harness import main

    sys.exit(main(bus_rows, __doc__))
