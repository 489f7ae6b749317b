"""A pseudo-terminal that knows whether a program has it open: opening the port resets most boards."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from pathlib import Path
from struct import Struct

from rtagent_drivers.emulation.terminal import Terminal

IN_CLOSE, IN_OPEN = 0x18, 0x20
EVENT = Struct("iIII")
"""inotify(7): which watch, what happened, and the size of a name, which a watched file has not."""


class WatchedTerminal(Terminal):
    """A pty that is watched; what is said while nobody has it open is lost, as on a USB port."""

    def __init__(self, link: Path) -> None:
        super().__init__(link)
        self._named = link
        self._library = ctypes.CDLL(None, use_errno=True)
        self._events: int = self._library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        self._programs = 0
        self._opened = False

    def plug(self) -> None:
        """Make the pty and its link."""
        super().plug()
        self._look()
        self._programs = 0
        self._library.inotify_add_watch(self._events, os.fsencode(self._named.readlink()), IN_OPEN | IN_CLOSE)

    def write(self, data: bytes) -> None:
        """Hand over bytes, if anybody has the port open."""
        self._look()
        if self._programs > 0:
            super().write(data)

    def was_opened(self) -> bool:
        """Return whether it was opened since this was asked last."""
        self._look()
        opened, self._opened = self._opened, False
        return opened

    def _look(self) -> None:
        for mask in self._new_events():
            self._opened = self._opened or bool(mask & IN_OPEN)
            self._programs += 1 if mask & IN_OPEN else -1 if mask & IN_CLOSE else 0

    def _new_events(self) -> Iterator[int]:
        try:
            data = os.read(self._events, 4096)
        except BlockingIOError:
            return
        for _, mask, _, _ in EVENT.iter_unpack(data):
            yield mask
