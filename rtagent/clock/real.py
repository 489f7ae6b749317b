"""The real clock: asyncio on an event loop whose timers are finer than a millisecond."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import selectors
import sys
import time
import zlib
from collections.abc import Callable
from math import ceil

CLOCK_MONOTONIC = 1
EARLY = 200e-6
"""A long wait (s) ends so much earlier and asyncio waits for the rest: the late return of a processor from sleep
falls into it."""
CHUNK = bytes(1 << 18)
"""Sums over more than a few kilobytes are computed without the GIL; this one takes some 50 µs."""
TFD_NONBLOCK_CLOEXEC = os.O_NONBLOCK | getattr(os, "O_CLOEXEC", 0)


class RealClock:
    """The machine's monotonic clock, which is also that of asyncio's own loops."""

    virtual = False
    now: Callable[[], int] = staticmethod(time.monotonic_ns)
    computed: Callable[[], int] = staticmethod(time.thread_time_ns)
    """How long (ns) this thread has kept a processor busy."""
    since_1970: Callable[[], int] = staticmethod(time.time_ns)
    """The time of the day, which may be set while a run goes on: for what people read, in ns."""

    def suspended(self) -> int:
        """Return how long (ns) the machine has been suspended since it was started, where that can be known."""
        boot_time = getattr(time, "CLOCK_BOOTTIME", None)
        return time.clock_gettime_ns(boot_time) - time.monotonic_ns() if boot_time is not None else 0

    async def sleep_until(self, when: int) -> None:
        """Return at `when` (ns), or at once where that has passed."""
        await asyncio.sleep(max(0, when - time.monotonic_ns()) / 1e9)

    async def compute(self, cost: int) -> None:
        """Keep the processor busy for `cost` (ns), blocking the loop as a long computation does."""
        until = time.monotonic_ns() + cost
        while time.monotonic_ns() < until:
            pass

    async def charge(self, cost: int) -> None:
        """Do nothing: under the real clock work costs what it costs."""


def occupy(duration: int) -> None:
    """Keep a processor busy for `duration` (ns) from any thread, without the GIL."""
    until = time.monotonic_ns() + duration
    while time.monotonic_ns() < until:
        zlib.crc32(CHUNK)


def real_loop() -> asyncio.AbstractEventLoop:
    """Return an event loop whose sleeps end within 0.2 ms (asyncio's own are rounded to 1 ms by epoll)."""
    with contextlib.suppress(OSError, AttributeError):
        if sys.platform == "linux":
            fine_timer_slack()
            return asyncio.SelectorEventLoop(TimerfdSelector())
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


class _Interval(ctypes.Structure):
    """The C structure itimerspec."""

    _fields_ = tuple((name, ctypes.c_long) for name in ("every_s", "every_ns", "first_s", "first_ns"))


if sys.platform == "linux":
    _Selector = selectors.EpollSelector
else:
    _Selector = selectors.SelectSelector


class Timerfd:
    """A timer of the kernel's that counts nanoseconds; its file can be read from when it has rung until it is set.

    Raises OSError or AttributeError where the system has none.
    """

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self.fd = self._libc.timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK_CLOEXEC)
        if self.fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create failed")
        self.armed = False
        self._setting = _Interval()

    def arm(self, timeout: float) -> None:
        """Let it ring in `timeout` seconds, or a little earlier where that is long; never, if it is 0."""
        nanoseconds = ceil((timeout - EARLY if timeout > 2 * EARLY else timeout) * 1e9)
        self._setting.first_s, self._setting.first_ns = divmod(nanoseconds, 1_000_000_000)
        self._libc.timerfd_settime(self.fd, 0, ctypes.byref(self._setting), None)
        self.armed = nanoseconds > 0

    def close(self) -> None:
        """Close its file."""
        os.close(self.fd)


class TimerfdSelector(_Selector):
    """Epoll whose time-outs are kept by a timerfd, which counts nanoseconds where epoll counts milliseconds.

    Raises OSError or AttributeError where the system has no timerfd.
    """

    def __init__(self) -> None:
        super().__init__()
        self._timer = Timerfd()
        self.register(self._timer.fd, selectors.EVENT_READ)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait at most `timeout` seconds (None: for ever) and return what is ready."""
        if timeout is not None and timeout > 0:
            self._timer.arm(timeout)
            timeout = None
        elif timeout is None and self._timer.armed:
            self._timer.arm(0)
        return [ready for ready in super().select(timeout) if ready[0].fd != self._timer.fd]

    def close(self) -> None:
        """Close the epoll and its timer."""
        super().close()
        self._timer.close()


def fine_timer_slack() -> None:
    """Ask the kernel not to delay this thread's timers by its usual 50 µs."""
    set_timer_slack = 29
    ctypes.CDLL(None).prctl(set_timer_slack, 1, 0, 0, 0)
