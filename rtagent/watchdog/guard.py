"""What the watchdog's process does: it waits for heartbeats, and makes everything safe when they cease."""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import select
import signal
import sys
from collections.abc import Sequence
from typing import Any

from rtagent import latched
from rtagent.watchdog.resorts import Resort, make_all_safe

INBOX, OUTBOX = 0, 1
PATIENCE = 5.0
"""How long (s) a device is waited for that is being made safe; meanwhile the others are safe already."""


class Inbox:
    """The lines that come from the runtime."""

    def __init__(self) -> None:
        self._rest = b""

    def lines(self, timeout: float | None) -> list[bytes]:
        """Return what has come within `timeout` (s; None: for ever); nothing after a silence; raise EOFError.

        A watchdog that was not let run itself looks again, before it takes that for silence.
        """
        if not select.select([INBOX], [], [], timeout)[0] and not select.select([INBOX], [], [], 0)[0]:
            return []
        data = os.read(INBOX, 1 << 16)
        if not data:
            raise EOFError
        *lines, self._rest = (self._rest + data).split(b"\n")
        return lines if lines else self.lines(timeout)


class Guard:
    """Guards the devices of one run, as told in `order`."""

    def __init__(self, order: dict[str, Any]) -> None:
        self._order = order
        self._latch = mmap.mmap(order["latch"], 1)
        self._resorts: list[Resort] = []
        self._hardware: list[str] = []

    def take(self, resorts: dict[str, dict[str, Any]]) -> None:
        """Open the spare handles of devices, by their names, in place of those before; raises what that raises."""
        for resort in self._resorts:
            resort.close()
        self._hardware = [told["hardware"] for told in resorts.values()]
        self._resorts = [Resort(name, told["function"], told["settings"]) for name, told in resorts.items()]
        for resort in self._resorts:
            resort.open()

    def make_safe(self) -> dict[str, Sequence[str]]:
        """Make everything safe; return, by the names of devices, what is not."""
        names = [resort.name for resort in self._resorts]
        return dict(zip(names, make_all_safe(self._resorts, PATIENCE), strict=True))

    def stop(self, reason: str) -> None:
        """Trip the latch, make everything safe, have it stay so, and tell."""
        self._latch[0] = 1
        found = self.make_safe()
        for hardware in self._hardware:
            with contextlib.suppress(OSError):  # it is told below in any case
                latched.latch(hardware, f"stopped by watchdog: {reason}", self._order["scenario"])
        not_safe = " ".join(sentence for sentences in found.values() for sentence in sentences)
        safe = f"Safe now: {', '.join(found)}."
        with contextlib.suppress(OSError):
            sys.stderr.write(f"rtagent watchdog: {reason}. {not_safe or safe}\n")
        tell({"stopped": reason, "not_safe": not_safe})

    def close(self) -> None:
        """Close the spare handles."""
        for resort in self._resorts:
            with contextlib.suppress(Exception):
                resort.close()


def tell(message: dict[str, Any]) -> None:
    """Send a message to the runtime, if there is still one."""
    with contextlib.suppress(OSError):
        os.write(OUTBOX, json.dumps(message).encode() + b"\n")


def main() -> None:
    """Guard until the runtime says that it has ended, or is gone."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    inbox = Inbox()
    try:
        first, *lines = inbox.lines(None)
    except EOFError:
        return
    order = json.loads(first)
    sys.path += [place for place in order["path"] if place not in sys.path]
    _ask_for_time(order["priority"])
    guard = Guard(order)
    try:
        _watch(guard, inbox, order["timeout"] / 1e9, [*lines])
    except EOFError:
        guard.stop("the runtime is gone")
    guard.close()


def _watch(guard: Guard, inbox: Inbox, timeout: float, lines: Sequence[bytes]) -> None:
    """Return at the end of the run; a silence counts from the first heartbeat on, and once."""
    wait: float | None = None
    while True:
        for line in lines:
            if line == b"end":
                return
            if line == b"stop":
                tell({"not_safe": guard.make_safe()})
            elif line:
                _take(guard, json.loads(line))
            else:
                wait = timeout
        lines = inbox.lines(wait)
        if not lines:
            guard.stop(f"the runtime was not heard for {timeout * 1e3:g} ms: its event loop had stalled")
            wait = None


def _take(guard: Guard, resorts: dict[str, dict[str, Any]]) -> None:
    try:
        guard.take(resorts)
    except Exception as error:
        tell({"failed": repr(error)})
    else:
        tell({"ready": True})


def _ask_for_time(priority: int) -> None:
    """Run on any processor, and before a loop of this priority: where that is not allowed, as others do."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(min(priority + 1, 99)))
