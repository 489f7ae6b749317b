"""A run's end of telemetry: starts the sender, gives the loop what writes to it, lets go of it in the end."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from typing import Any

import msgspec

from rtagent.clock import RealClock
from rtagent.telemetry.collect import Collector
from rtagent.telemetry.connection import Access
from rtagent.telemetry.feeding import Feeder
from rtagent.telemetry.keys import Place
from rtagent.telemetry.lull import Lull, Pace
from rtagent.telemetry.ring import DATA, Ring
from rtagent.telemetry.sender import Order
from rtagent.units import second

RING = 8 << 20
"""How many bytes there are between the run and its sender."""
PATIENT, HURRIED = 3.0, 0.4
"""How long (s) the end of a run waits for a sender that makes no progress: of one that is done, or was stopped."""
AT_MOST = 30 * second
"""How long (ns) one that is done waits while the sender makes progress."""
GONE = 0.2
"""How long (s) it may take to be gone, once it has said its last."""
DONE = "done"
"""How a run ends that comes to its end."""
ROOM = 0.0005
"""How often (s) a run under the virtual clock looks whether there is room again."""


@dataclass(frozen=True)
class Wishes:
    """What is to become of a run's records: published with `publish` (None: not), recorded in `record` ("": not).

    `buffer` is how many cycles may wait. `commands` are what a viewer may ask for, by name, each called with a
    text; without any there is no control.
    """

    publish: Access | None = field(default_factory=Access)
    record: str = ""
    buffer: int = 5000
    commands: Mapping[str, Callable[[str], None]] = field(default_factory=dict)


class Link:
    """The connection of a run with its sender; `collector` is the instrument that writes to it."""

    def __init__(self, about: Mapping[str, Any], place: Place, wishes: Wishes, pace: Pace) -> None:
        self._wishes, self._virtual = wishes, about["clock"] == "virtual"
        self._pace = pace = Pace() if self._virtual else pace  # its lulls are not those of the real clock
        self._fd = _shared_file(DATA + RING)
        self._ring = Ring(self._fd, RING)
        self._closing = self.closed = False
        """Whether the sender has ended what it does, and the recording is complete."""
        self.collector = Collector(about["state"], wishes.buffer, self._make_room if self._virtual else None)
        self._feeder = Feeder(self.collector, self._ring, Lull(pace))
        self._process = self._start(about, place)
        self._listener = threading.Thread(target=self._listen, name="telemetry", daemon=True)
        self._listener.start()
        if not self._virtual:
            self._feeder.start()

    def _start(self, about: Mapping[str, Any], place: Place) -> subprocess.Popen[bytes]:
        wishes, now = self._wishes, RealClock.now()
        times = {"epoch_ns": 0, "began_ns": 0} if self._virtual else {"epoch_ns": epoch(), "began_ns": now}
        told = dict(about) | times | {"agent": place.agent, "run": place.run_id, "control": bool(wishes.commands)}
        order = Order(
            self._fd, RING, (place.agent, place.run_id), told, wishes.publish, wishes.record, bool(wishes.commands),
            list(wishes.commands), self._pace,
        )  # fmt: skip
        process = subprocess.Popen(  # our own program
            [sys.executable, "-m", "rtagent.telemetry.sender"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, pass_fds=[self._fd], bufsize=0,
        )  # fmt: skip
        data = msgspec.json.encode(order)
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(len(data).to_bytes(8, "little") + data)
        return process

    def _make_room(self) -> None:
        """Hand on what was appended, at once; the world of the virtual clock stands still meanwhile."""
        pause = threading.Event()
        while self.collector.buffer and self._process.poll() is None:
            if not self._feeder.feed():
                pause.wait(ROOM)

    def _listen(self) -> None:
        """Take what the sender says, until it ends."""
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._hear(json.loads(line))
        if not self._closing:
            self.collector.troubles.append("telemetry's own process has ended, and nothing is sent any more.")

    def _hear(self, said: Mapping[str, Any]) -> None:
        if "trouble" in said:
            self.collector.troubles.append(said["trouble"])
        elif "command" in said:
            self._obey(said["command"], said["text"])
        elif "closed" in said:
            self.closed = said["closed"]

    @property
    def pid(self) -> int:
        """The process of the sender."""
        return self._process.pid

    def _obey(self, command: str, text: str) -> None:
        """Do what a viewer asks for: stop at once, all else on the event loop."""
        do = partial(self._wishes.commands[command], text)
        loop = self.collector.loop
        if command == "stop" or loop is None:
            do()
            return
        with contextlib.suppress(RuntimeError):  # the loop has just been closed
            loop.call_soon_threadsafe(do)

    def close(self, how: str) -> list[str]:
        """Tell how the run ended, and let the sender finish; one that hangs is left behind.

        Return, in sentences, what went wrong and was not told to the run.
        """
        patience = PATIENT if how == DONE else HURRIED
        self._closing = True
        self.collector.end(how)
        if not self._virtual:
            self._feeder.close(patience)
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._listener.join(patience)
        self._wait_on(patience if how == DONE else 0.0)
        self._let_go()
        if self._wishes.record and not self.closed and not self.collector.troubles:
            self.collector.troubles.append(
                f"{self._wishes.record} is not complete yet: its recorder writes on, or has ended."
            )
        return list(self.collector.troubles)

    def _wait_on(self, patience: float) -> None:
        """Wait for a sender for as long as it makes progress."""
        end, left = RealClock.now() + AT_MOST, -1
        while patience and self._listener.is_alive() and RealClock.now() < end and left != self._ring.filled:
            left = self._ring.filled
            self._listener.join(patience)

    def _let_go(self) -> None:
        """See the sender's process off; one that still writes ends by itself, and is not waited for."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(GONE if not self._listener.is_alive() else 0)
        self._process.returncode = 0
        os.close(self._fd)


def time_of_day() -> str:
    """Return when it is, as a name that sorts: in UTC, to the second."""
    return datetime.fromtimestamp(RealClock.since_1970() / second, UTC).strftime("%Y%m%dT%H%M%S")


def epoch() -> int:
    """Return when, in ns since 1970, this machine's monotonic clock was 0."""
    return RealClock.since_1970() - RealClock.now()


def _shared_file(size: int) -> int:
    """Return a file in memory that another process can share."""
    if hasattr(os, "memfd_create"):
        fd = os.memfd_create("rtagent-telemetry")
    else:
        fd, path = tempfile.mkstemp("rtagent-telemetry")
        os.unlink(path)  # noqa: PTH108  # it has no name from here on
    os.ftruncate(fd, size)
    return fd
