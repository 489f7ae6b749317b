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


def listen(heard: Heard, file: int | None = None, *, releases: bool = False) -> Callable[[], None] | None:
    """Have `heard` called with each key of the terminal `file` (standard input); return what ends that.

    Keys then come at once and without an echo, and with their `releases` where the terminal can tell them and all
    who listen want them: Ctrl-C is then a key as well, which a loop that hangs would not hear. None where it is no
    terminal, or this process is not in front.
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
    terminal.add(heard, releases)
    return lambda: terminal.remove(heard)


def _in_front(file: int) -> bool:
    try:
        return os.isatty(file) and os.tcgetpgrp(file) == os.getpgrp()
    except OSError:
        return False


class _Terminal:
    """A terminal that is listened to."""

    def __init__(self, file: int) -> None:
        self._file, self._keys = file, Keys()
        self._listeners: dict[Heard, bool] = {}
        self._tells_releases = False
        self._before = termios.tcgetattr(file)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(file, self._hear)  # a loop that cannot leaves the terminal as it is
        tty.setcbreak(file, termios.TCSANOW)
        atexit.register(self.give_back)

    def add(self, heard: Heard, releases: bool) -> None:
        """Tell one more; ask whether the terminal tells of releases, where one is to be told of them."""
        self._listeners[heard] = releases
        if releases and not self._keys.speaks:
            self._write(ASK)
        self._choose()

    def remove(self, heard: Heard) -> None:
        """Tell one less; the last gives the terminal back."""
        self._listeners.pop(heard, None)
        if self._listeners:
            self._choose()
        else:
            self.give_back()

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
        self._choose()
        for key in keys:
            self._tell(key)

    def _choose(self) -> None:
        """Have releases told where that is possible and wanted by all."""
        wanted = self._keys.speaks and all(self._listeners.values())
        if wanted != self._tells_releases:
            self._tells_releases = wanted
            self._write(BEGIN if wanted else END)

    def _tell(self, key: Key) -> None:
        if key.told and key.control and key.kind == "press" and key.name in SIGNALS:
            os.kill(os.getpid(), SIGNALS[key.name])
        for heard in list(self._listeners):
            heard(key)

    def _write(self, sequence: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._file, sequence)
