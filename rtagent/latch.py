"""The latch: once it is tripped nothing moves any more. It cannot be taken back."""

from __future__ import annotations

import mmap
import os
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rtagent.errors import StoppedError


class Latch:
    """Tripped once, for good: by any thread, by a signal handler, or by the watchdog, which shares `memory`.

    `source` is who tripped it (person, keyboard, signal, limit, watchdog), `reason` is why, in a sentence; both are
    empty until then.
    """

    def __init__(self) -> None:
        self.fd = _shared_memory()
        """What another process maps to see and to trip it (-1 where the system shares no such memory)."""
        self.memory = mmap.mmap(self.fd, 1)
        """One byte: 0 until it is tripped."""
        self.source = self.reason = ""
        self._once = threading.Lock()
        self._listeners: list[Callable[[], None]] = []
        if self.fd >= 0:
            weakref.finalize(self, os.close, self.fd)

    @property
    def tripped(self) -> bool:
        """Whether it is tripped."""
        return self.memory[0] != 0

    def trip(self, source: str, reason: str) -> None:
        """Trip it; the first one's source and reason stay."""
        if not self._once.acquire(blocking=False):
            return
        self.source, self.reason = source, reason
        self.memory[0] = 1
        for listener in tuple(self._listeners):
            listener()

    @contextmanager
    def heard_by(self, listener: Callable[[], None]) -> Iterator[None]:
        """Have `listener` called, in the thread that trips it; at once where it is tripped already."""
        self._listeners.append(listener)
        if self.tripped:
            listener()
        try:
            yield
        finally:
            self._listeners.remove(listener)

    def check(self) -> None:
        """Raise `StoppedError` where it is tripped."""
        if self.memory[0]:
            raise self.error()

    def error(self) -> StoppedError:
        """Return what tells by whom, and why, it was tripped."""
        if not self.reason:  # only the watchdog trips it from outside, and what it says is still on its way
            return StoppedError("stopped by watchdog: the event loop had stalled")
        return StoppedError(f"stopped by {self.source}: {self.reason}")


def _shared_memory() -> int:
    if not hasattr(os, "memfd_create"):
        return -1
    fd = os.memfd_create("rtagent-latch")
    os.ftruncate(fd, 1)
    return fd
