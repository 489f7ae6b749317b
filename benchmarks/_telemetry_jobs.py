"""Runs whose telemetry is measured, and what watches, stops and kills them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.clock import RealClock
from rtagent.errors import RtagentError
from rtagent.instruments import Hooks
from rtagent.latch import Latch
from rtagent.realtime import manners
from rtagent.realtime.machine import available_processors
from rtagent.scenario import assemble, load
from rtagent.telemetry.connection import Access
from rtagent.telemetry.describing import about_run
from rtagent.telemetry.keys import Place
from rtagent.telemetry.link import Link, Wishes
from rtagent.telemetry.reading import Scan
from rtagent.telemetry.recovering import recover
from rtagent.telemetry.wishes import pace_of

SCENARIO = Path(__file__).parent / "_telemetry.toml"
ENDPOINT = "tcp/127.0.0.1:7457"
PRIORITY = 50
"""Of the variants whose names end with `PRIORITIZED`: the loop's, as a scenario asks for it."""
PRIORITIZED = ", with a priority"
ANYWHERE = ", on any processor"
"""The end of the names of variants whose loop is where the kernel puts it; others keep theirs on one processor, for
where it happens to be makes more of a difference here than telemetry does."""
ANOTHERS = "another's"
"""The variant without telemetry of its own, beside as much traffic of another program, and who listens to it."""
WARM_UP = 500
"""So many first cycles of a block are left out: the sender and its router start meanwhile."""
STARTED = 1000
"""So many first records have waited for the sender to start: their age is not looked at."""

SUBSCRIBER = """
import sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
session = zenoh.open(config)
subscriber = session.declare_subscriber("rtagent/**")
print("ready", flush=True)
for sample in subscriber:
    pass
"""

TRAFFIC = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
session = zenoh.open(config)
records = [(session.declare_publisher(f"rtagent/another/{n}"), bytes(1500 if n == 0 else 200)) for n in range(7)]
print("ready", flush=True)
when = time.monotonic()
while True:
    when += 0.002
    time.sleep(max(0, when - time.monotonic()))
    for publisher, data in records:
        publisher.put(data)
"""
"""As many bytes and messages as those of a run at 500 Hz."""

COUNTER = """
import asyncio, contextlib, json, sys, time
from rtagent.telemetry.connection import Access
from rtagent.telemetry.subscribe import subscribe

async def main():
    seen, missed, lost, ended, ages = {}, {}, {}, None, []
    access = Access(endpoint=sys.argv[1])
    told = lambda: print("ready", flush=True)
    async with contextlib.aclosing(subscribe(access=access, connected=told)) as messages:
        async for message in messages:
            stream, record = message.stream, message.record
            first = record.sequence if stream not in seen else 0
            seen[stream] = seen.get(stream, 0) + 1
            missed[stream] = missed.get(stream, 0) + message.missed + first
            if stream == "observation":
                ages.append(time.monotonic_ns() - record.time_ns)
            if stream == "counters":
                lost = {k[5:]: v for k, v in record.values.items() if k.startswith("lost.")}
                if ended:
                    break
            if stream == "run" and record.ended:
                ended = record.ended
    print(json.dumps({"seen": seen, "missed": missed, "lost": lost, "ages": ages}))

asyncio.run(main())
"""


STALLED = """
import io, threading
from rtagent.telemetry import recording

class Disk(io.BytesIO):
    def write(self, data):
        if self.tell() > 1 << 16:
            threading.Event().wait()
        return super().write(data)

recording.open_new = lambda path: Disk()
"""


@dataclass
class Block:
    """How late cycles began, and what telemetry cost in each of them, in µs."""

    lateness: NDArray[np.float64]
    cost: NDArray[np.float64]


class Stopwatch:
    """Times how late the loop wakes, and what it spends in hooks, a cycle at a time."""

    def __init__(self) -> None:
        self.lateness: list[int] = []
        self.costs: list[int] = []
        self._spent = 0
        self.own = int(np.median([-time.monotonic_ns() + time.monotonic_ns() for _ in range(1000)]))

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        sleep, begin, tell = RealClock.sleep_until, Hooks.__init__, Hooks.tell

        async def timed_sleep(clock: RealClock, when: int) -> None:
            await sleep(clock, when)
            self.lateness.append(time.monotonic_ns() - when)

        def timed_begin(hooks: Hooks, *args: Any) -> None:
            begin(hooks, *args)
            note = hooks.note

            def timed_note(call: Any) -> None:
                start = time.monotonic_ns()
                note(call)
                self._spent += time.monotonic_ns() - start - self.own

            hooks.note = timed_note

        def timed_tell(hooks: Hooks) -> None:
            start = time.monotonic_ns()
            tell(hooks)
            self.costs.append(self._spent + time.monotonic_ns() - start - self.own)
            self._spent = 0

        RealClock.sleep_until, Hooks.tell = timed_sleep, timed_tell  # type: ignore[method-assign]
        Hooks.__init__ = timed_begin  # type: ignore[method-assign]
        try:
            yield
        finally:
            RealClock.sleep_until, Hooks.tell = sleep, tell  # type: ignore[method-assign]
            Hooks.__init__ = begin  # type: ignore[method-assign]


def block(variant: str, seconds: float, folder: Path, number: int) -> Block:
    """Run the agent for some seconds, with its telemetry as the variant says."""
    scenario = load(SCENARIO, ["run.episodes=100000", *settings(variant)])
    name = f"{variant.replace(', ', '-').replace(' ', '-')}-{number}"
    variant = variant.removesuffix(PRIORITIZED).removesuffix(ANYWHERE)
    assembly, watch, latch, link = assemble(scenario), Stopwatch(), Latch(), None
    with contextlib.ExitStack() as stack:
        stack.enter_context(surroundings(variant, folder))
        granted = stack.enter_context(manners(assembly.realtime))
        if variant not in ("off", ANOTHERS):
            wishes = Wishes(Access(endpoint=ENDPOINT), str(folder / f"{name}.mcap"))
            link = Link(about_run(scenario, assembly), Place("benchmark", name), wishes, pace_of(assembly.schedule))
        stack.enter_context(watch.running())

        async def main() -> None:
            asyncio.get_running_loop().call_later(seconds, latch.trip, "limit", "the block is over")
            if link is not None and variant == "sender stopped":
                asyncio.get_running_loop().call_later(1.0, os.kill, link.pid, signal.SIGSTOP)
            with contextlib.suppress(RtagentError):
                await assembly.run([link.collector] if link is not None else [], latch=latch)

        granted.run(main())
    if link is not None:
        if variant == "sender stopped":
            os.kill(link.pid, signal.SIGCONT)
        link.close("done" if variant != "disk stalled" else "the disk is stalled")
    return Block(*(np.array(values[WARM_UP:]) / 1e3 for values in (watch.lateness, watch.costs)))


def settings(variant: str) -> Iterator[str]:
    """Yield what the loop of a variant asks of the machine."""
    if variant.endswith(PRIORITIZED):
        yield f"realtime.priority={PRIORITY}"
    if not variant.endswith(ANYWHERE):
        yield f"realtime.processors=[{min(available_processors())}]"


@contextlib.contextmanager
def surroundings(variant: str, folder: Path) -> Iterator[None]:
    """Have around the run what the variant says."""
    with contextlib.ExitStack() as stack:
        if variant in ("watched", "stopped", "killed", ANOTHERS):
            stack.enter_context(subscriber(variant))
        if variant == ANOTHERS:
            stack.enter_context(program(TRAFFIC))
        if variant == "disk stalled":
            stack.enter_context(stalled_disk(folder))
        yield


@contextlib.contextmanager
def stalled_disk(folder: Path) -> Iterator[None]:
    """Have the senders that start now record to a disk that soon takes nothing more, and keeps who writes to it."""
    (folder / "sitecustomize.py").write_text(STALLED)
    os.environ["PYTHONPATH"] = str(folder)
    try:
        yield
    finally:
        del os.environ["PYTHONPATH"]


@contextlib.contextmanager
def subscriber(variant: str) -> Iterator[None]:
    """Have a plain program listen, that is stopped or killed once it does, where the variant says so."""
    endpoint = Access(endpoint=ENDPOINT)
    from rtagent.telemetry.connection import open_client

    with contextlib.ExitStack() as stack:
        with open_client(endpoint):  # so that there is a router
            process = stack.enter_context(program(SUBSCRIBER))
        if variant == "stopped":
            process.send_signal(signal.SIGSTOP)
        if variant == "killed":
            process.kill()
        yield


@contextlib.contextmanager
def program(text: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program that says when it is ready, and kill it in the end."""
    process = subprocess.Popen([sys.executable, "-c", text, ENDPOINT], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def command(*settings: str, record: Path | None = None) -> list[str]:
    """Return the command line of a run."""
    given = [
        part
        for each in (f"telemetry.endpoint={ENDPOINT}", "run.episodes=100000", *settings)
        for part in ("--set", each)
    ]
    recorded = ["--record", str(record)] if record else []
    return [sys.executable, "-m", "rtagent", "run", str(SCENARIO), "--quiet", *given, *recorded]


@dataclass
class Seen:
    """How many records there were of all streams, how many nobody accounts for, and how old (ms) they came."""

    records: int
    unaccounted_at_subscriber: int
    unaccounted_in_recording: int
    lost: int
    ages: NDArray[np.float64]


def complete(seconds: float, folder: Path) -> Seen:
    """Run at 1 kHz beside a subscriber, and compare what it and the recorder have with what was told to be lost."""
    from rtagent.telemetry.connection import open_client

    path = folder / "complete.mcap"
    with open_client(Access(endpoint=ENDPOINT)):
        counter = subprocess.Popen([sys.executable, "-c", COUNTER, ENDPOINT], stdout=subprocess.PIPE, text=True)
        assert counter.stdout is not None
        counter.stdout.readline()
    run = subprocess.Popen(command("schedule.period=1ms", record=path), stderr=subprocess.DEVNULL)
    time.sleep(seconds)
    run.send_signal(signal.SIGINT)
    run.wait(20)
    told = json.loads(counter.communicate(timeout=20)[0])
    counts: dict[str, int] = {}
    numbers: dict[str, int] = {}
    for entry in Scan(path):
        counts[entry.stream] = counts.get(entry.stream, 0) + 1
        numbers[entry.stream] = max(numbers.get(entry.stream, 0), entry.sequence + 1)
    lost = told["lost"]
    return Seen(
        sum(numbers.values()),
        sum(abs(missing - lost.get(stream, 0)) for stream, missing in told["missed"].items()),
        sum(abs(numbers[stream] - counts[stream] - lost.get(stream, 0)) for stream in counts),
        sum(lost.values()),
        np.array(told["ages"][STARTED:]) / 1e6,
    )


def killed(folder: Path, number: int, rng: random.Random, *, with_sender: bool) -> float:
    """Kill a run at a random moment; return how much (s) its recovered recording lacks before that."""
    path = folder / f"dead-{number}.mcap"
    run = subprocess.Popen(command(record=path), stderr=subprocess.DEVNULL)
    while not path.exists() or path.stat().st_size < 1000:
        time.sleep(0.01)
    time.sleep(rng.uniform(0.2, 2.0))
    sender = subprocess.run(
        ["/usr/bin/pgrep", "-P", str(run.pid)], capture_output=True, text=True, check=False
    ).stdout.split()
    moment = time.monotonic_ns()
    for process in [run.pid, *map(int, sender if with_sender else [])]:
        os.kill(process, signal.SIGKILL)
    run.wait()
    until_gone(sender)
    saved = path.with_suffix(".saved.mcap")
    recover(path, saved)
    newest = max(entry.record().time_ns for entry in Scan(saved) if entry.stream == "observation")
    return (moment - newest) / 1e9


def until_gone(processes: list[str]) -> None:
    """Wait until they have ended, which takes a sender as long as its disk takes to write."""
    end = time.monotonic() + 60
    while any(Path(f"/proc/{process}").exists() for process in processes) and time.monotonic() < end:
        time.sleep(0.01)


def interrupted(folder: Path) -> float:
    """Return how long (s) a watched and recorded run needs to be gone after Ctrl-C."""
    path = folder / "interrupted.mcap"
    with subscriber("watched"):
        run = subprocess.Popen(command(record=path), stderr=subprocess.DEVNULL)
        while not path.exists() or path.stat().st_size < 1000:
            time.sleep(0.01)
        time.sleep(1.0)
        start = time.monotonic()
        run.send_signal(signal.SIGINT)
        run.wait(20)
        return time.monotonic() - start
