"""The terminal's keys, for all who listen: one reader, and one state of the terminal, given back by the last."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import os
import signal
import sys
import termios
import tty
from collections.abc import Callable

from rtagent.keys import ASK, BEGIN, END, Key, Keys

Heard = Callable[[Key], None]
SIGNALS = {"c": signal.SIGINT, "\\": signal.SIGQUIT}
"""A terminal that reports every key sends no signals: they are made here."""

_listened_to: dict[int, _Terminal] = {}


def listen(heard: Heard, file: int | None = None) -> Callable[[], None] | None:
    """Have `heard` called with each key of the terminal `file` (standard input); return what ends that.

    Keys then come at once and without an echo. None where it is no terminal, or this process is not in front.
    """
    if file is None:
        try:
            file = sys.stdin.fileno()
        except (OSError, ValueError, AttributeError):
            return None
    if file not in _listened_to:
        if not _in_front(file):
            return None
        _listened_to[file] = _Terminal(file)
    terminal = _listened_to[file]
    terminal.listeners.append(heard)
    return lambda: _end(terminal, heard)


def _end(terminal: _Terminal, heard: Heard) -> None:
    if heard in terminal.listeners:
        terminal.listeners.remove(heard)
    if not terminal.listeners:
        terminal.give_back()


def _in_front(file: int) -> bool:
    try:
        return os.isatty(file) and os.tcgetpgrp(file) == os.getpgrp()
    except OSError:
        return False


class _Terminal:
    """A terminal that is listened to."""

    def __init__(self, file: int) -> None:
        self._file, self._keys = file, Keys()
        self.listeners: list[Heard] = []
        self._tells_releases = False
        self._before = termios.tcgetattr(file)
        self._loop = asyncio.get_running_loop()
        tty.setcbreak(file, termios.TCSANOW)
        atexit.register(self.give_back)
        self._write(ASK)
        self._loop.add_reader(file, self._hear)

    def give_back(self) -> None:
        """Leave it as it was; what was typed and not read is dropped, answers to what was asked among it."""
        if _listened_to.pop(self._file, None) is None:
            return
        atexit.unregister(self.give_back)
        if not self._loop.is_closed():
            self._loop.remove_reader(self._file)
        if self._tells_releases:
            self._write(END)
        with contextlib.suppress(termios.error):
            termios.tcflush(self._file, termios.TCIFLUSH)
            termios.tcsetattr(self._file, termios.TCSANOW, self._before)  # waits for nothing

    def _hear(self) -> None:
        try:
            data = os.read(self._file, 1024)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._loop.remove_reader(self._file)  # it is gone
        keys = self._keys.feed(data)
        if self._keys.speaks and not self._tells_releases:
            self._tells_releases = True
            self._write(BEGIN)
        for key in keys:
            self._tell(key)

    def _tell(self, key: Key) -> None:
        if key.told and key.control and key.kind == "press" and key.name in SIGNALS:
            os.kill(os.getpid(), SIGNALS[key.name])
        for heard in list(self.listeners):
            heard(key)

    def _write(self, sequence: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._file, sequence)
