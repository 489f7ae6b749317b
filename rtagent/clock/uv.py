"""The event loop of uvloop, with timers as fine as those of the real clock's own loop.

Its own count whole milliseconds, up to one of which a sleep ends too early or too late. Import this module only
where uvloop is wanted: it raises ImportError where it is not installed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextvars import Context
from heapq import heapify, heappop, heappush
from itertools import count
from typing import TypeVarTuple

import uvloop

from rtagent.clock.real import RealClock, Timerfd, fine_timer_slack

SHORTEST = 1e-9
MANY_CANCELLED = 100

Ts = TypeVarTuple("Ts")


def uvloop_loop() -> asyncio.AbstractEventLoop:
    """Return an event loop of uvloop's; raise OSError or AttributeError where the system has no timerfd."""
    fine_timer_slack()
    return FineUvloop()


class FineUvloop(uvloop.Loop):
    """An event loop of uvloop's whose timers are kept here and rung by a timerfd."""

    def __init__(self) -> None:
        super().__init__()
        self._timers: list[tuple[float, int, asyncio.TimerHandle]] = []
        self._order = count()
        self._cancelled = 0
        self._timerfd = Timerfd()
        self.add_reader(self._timerfd.fd, self._ring)

    def time(self) -> float:
        """Return the time (s) of the monotonic clock."""
        return RealClock.now() / 1e9

    def call_later(
        self, delay: float, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """Call `callback` in `delay` seconds."""
        return self.call_at(self.time() + delay, callback, *args, context=context)

    def call_at(
        self, when: float, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """Call `callback` when the loop's time is `when`."""
        handle = asyncio.TimerHandle(when, callback, args, self, context)
        heappush(self._timers, (when, next(self._order), handle))
        if self._timers[0][2] is handle:
            self._arm()
        return handle

    def close(self) -> None:
        """Close the loop and its timer."""
        if not self.is_closed():
            self.remove_reader(self._timerfd.fd)
            self._timerfd.close()
            self._timers.clear()
        super().close()

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None:
        """Forget cancelled timers when they are many, as asyncio's own loops do."""
        self._cancelled += 1
        if self._cancelled > max(MANY_CANCELLED, len(self._timers) // 2):
            self._timers = [timer for timer in self._timers if timer[2] is not handle and not timer[2].cancelled()]
            heapify(self._timers)
            self._cancelled = 0

    def _ring(self) -> None:
        """Call all that is due now; what it makes due comes after the events that are waiting."""
        now = self.time()
        try:
            while self._timers and self._timers[0][0] <= now:
                handle = heappop(self._timers)[2]
                if not handle.cancelled():
                    handle._run()
        finally:
            self._arm()

    def _arm(self) -> None:
        self._timerfd.arm(max(self._timers[0][0] - self.time(), SHORTEST) if self._timers else 0)
