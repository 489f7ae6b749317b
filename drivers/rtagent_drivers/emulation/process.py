"""The loop of an emulator: between a emulated device, a terminal, and orders on the standard input."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from rtagent.clock.real import RealClock, TimerfdSelector, fine_timer_slack
from rtagent.errors import RtagentError
from rtagent.units import second, us
from rtagent_drivers.emulation.terminal import Terminal

SPIN = 50 * us
"""The last stretch before something is due is spent looking at the clock, with true timing."""

STDIN = 0

NICENESS = -10
"""A device has a processor of its own: it waits for no other process, where the system grants that."""


@dataclass(frozen=True)
class Way:
    """How an emulator runs: with `timing` it watches the clock; it ends `linger` (ns) after its input."""

    timing: bool = False
    linger: int | None = None


class Emulated(Protocol):
    """What is at the other end of a serial line; times in ns."""

    @property
    def unplugged(self) -> bool:
        """Whether the line is gone."""

    def receive(self, now: int, data: bytes, baud: int, /) -> None:
        """Take bytes that a program has sent at `baud` bits a second."""

    def due(self) -> int | None:
        """Return when it next has something to say, or None until it is told something."""

    def take(self, now: int, /) -> bytes:
        """Return what it has said by `now`."""


class Emulator:
    """What is emulated, a terminal, and the loop between them; `obey` does what a line says and returns a reply."""

    def __init__(
        self, bus: Emulated, obey: Callable[[int, str], dict[str, Any] | None], terminal: Terminal, way: Way
    ) -> None:
        self._bus, self._do, self._terminal, self._way = bus, obey, terminal, way
        self._now: Callable[[], int] = RealClock.now
        self._orders = b""
        self._ends_at: int | None = None

    def run(self, ready: Callable[[], None]) -> None:
        """Go on until the end; call `ready` once programs can open the link."""
        _ask_for_priority()
        fine_timer_slack()
        with TimerfdSelector() as self._selector:
            self._listen_to_orders()
            try:
                self._plug()
                ready()
                while self._ends_at is None or self._now() < self._ends_at:
                    self._turn()
            finally:
                self._terminal.unplug()

    def _turn(self) -> None:
        due = self._due()
        for key, _ in self._selector.select(self._patience(due)):
            if key.fd == STDIN:
                self._take_orders()
            else:
                self._take_bytes()
        now = self._await(due)
        data = self._bus.take(now)
        if self._bus.unplugged != (self._terminal.fileno < 0):
            self._unplug() if self._bus.unplugged else self._plug()
        if data and not self._bus.unplugged:
            self._terminal.write(data)

    def _due(self) -> int | None:
        times = (self._bus.due(), self._ends_at)
        return min((time for time in times if time is not None), default=None)

    def _patience(self, due: int | None) -> float | None:
        """Return how long (s) to sleep at most; None: until something comes."""
        if due is None:
            return None
        return max(0, due - self._now() - (SPIN if self._way.timing else 0)) / second

    def _await(self, due: int | None) -> int:
        """Look at the clock until what is due very soon is due; return the time."""
        now = self._now()
        if due is not None and self._way.timing and due - now <= SPIN:
            while now < due:
                now = self._now()
        return now

    def _take_bytes(self) -> None:
        data = self._terminal.read()
        self._bus.receive(self._now(), data, self._terminal.baud())

    def _take_orders(self) -> None:
        data = os.read(STDIN, 65536)
        if not data:
            self._selector.unregister(STDIN)
            self._ends_at = None if self._way.linger is None else self._now() + self._way.linger
        *lines, self._orders = (self._orders + data).split(b"\n")
        for line in lines:
            if line.strip():
                self._obey(line.decode(errors="replace"))

    def _obey(self, line: str) -> None:
        try:
            told = self._do(self._now(), line)
        except RtagentError as error:
            sys.stderr.write(f"{error}\n")
            return
        if told is not None:
            sys.stdout.write(json.dumps(told) + "\n")
            sys.stdout.flush()

    def _listen_to_orders(self) -> None:
        in_background = os.isatty(STDIN) and os.tcgetpgrp(STDIN) != os.getpgrp()
        if not in_background:
            with contextlib.suppress(PermissionError):  # a file, or /dev/null: no orders will come
                self._selector.register(STDIN, selectors.EVENT_READ)

    def _plug(self) -> None:
        self._terminal.plug()
        self._selector.register(self._terminal.fileno, selectors.EVENT_READ)

    def _unplug(self) -> None:
        self._selector.unregister(self._terminal.fileno)
        self._terminal.unplug()


def _ask_for_priority() -> None:
    with contextlib.suppress(PermissionError):
        os.nice(NICENESS)
