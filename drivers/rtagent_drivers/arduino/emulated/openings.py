"""Notices that a program opens a serial port: on most boards that resets them."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

IN_OPEN = 0x20
"""inotify(7)."""


class Openings:
    """The openings of what a link names, which may be another file after it was plugged in anew."""

    def __init__(self, link: Path) -> None:
        self._link, self._target = link, b""
        self._library = ctypes.CDLL(None, use_errno=True)
        self._fd: int = self._library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)

    def seen(self) -> bool:
        """Return whether it was opened since this was asked last."""
        self._follow()
        try:
            return bool(os.read(self._fd, 4096))
        except BlockingIOError:
            return False

    def _follow(self) -> None:
        try:
            target = os.fsencode(self._link.readlink())
        except OSError:
            return
        if target != self._target:
            self._target = target
            self._library.inotify_add_watch(self._fd, target, IN_OPEN)
