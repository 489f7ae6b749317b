"""The keys of a terminal, read by a thread: each has the time at which it came, whatever the event loop does."""

from __future__ import annotations

import contextlib
import os
import select
import termios
import threading
import tty
from collections.abc import Callable

from rtagent.clock.real import RealClock
from rtagent.keys import Key, Keys

Heard = Callable[[Key, int], None]


class KeyReader:
    """Calls `heard`, in its thread, with each key of the terminal `file` and its time (ns), until it is closed.

    A loop that learns for 50 ms at a stretch would know of a press only afterwards, and take that for its time.
    """

    def __init__(self, file: int, heard: Heard) -> None:
        self._file, self._heard = file, heard
        self._before = termios.tcgetattr(file)
        self._ended, self._end = os.pipe()
        tty.setcbreak(file, termios.TCSANOW)
        self._thread = threading.Thread(target=self._read, name="rtagent-keys", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading, and give the terminal back as it was."""
        os.write(self._end, b"!")
        self._thread.join()
        for end in (self._ended, self._end):
            os.close(end)
        with contextlib.suppress(termios.error):
            termios.tcflush(self._file, termios.TCIFLUSH)
            termios.tcsetattr(self._file, termios.TCSANOW, self._before)

    def _read(self) -> None:
        keys = Keys()
        while True:
            ready, _, _ = select.select([self._file, self._ended], [], [])
            now = RealClock.now()
            if self._ended in ready:
                return
            try:
                data = os.read(self._file, 1024)
            except OSError:
                data = b""
            if not data:  # the terminal is gone
                return
            for key in keys.feed(data):
                self._heard(key, now)
