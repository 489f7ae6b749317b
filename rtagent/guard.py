"""The guard against calls that hang: one timer for all of them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

from rtagent.clock import Clock
from rtagent.units import describe

T = TypeVar("T")
NEVER = 1 << 62


class HangGuard:
    """Cancels the running task when an awaited call is overdue: one timer for all calls, not one each.

    A call that does not even yield to cancellation sets `stuck`; whoever waits for that gives the task up.
    """

    def __init__(self, clock: Clock) -> None:
        self._now = clock.now
        self._loop = asyncio.get_running_loop()
        self._task: asyncio.Task[object] | None = None
        self._deadline = 0
        self._limit = 0
        self._timer: asyncio.TimerHandle | None = None
        self._looks_at = NEVER
        self._cancelled = False
        self._what = ""
        self.stuck: asyncio.Future[str] = self._loop.create_future()

    async def bound(self, call: Awaitable[T], limit: int, what: str) -> T:
        """Await `call` for at most `limit` (ns); raise TimeoutError where it takes longer."""
        self.arm(limit, what)
        try:
            return await call
        except BaseException as error:
            raise self.explained(error) from None
        finally:
            self.disarm()

    def arm(self, limit: int, what: str) -> None:
        """Begin to watch a call that the running task awaits, for at most `limit` (ns)."""
        self._what, self._limit = what, limit
        self._deadline = self._now() + limit
        if self._deadline < self._looks_at:
            self._watch(limit)

    def disarm(self) -> None:
        """End watching the call."""
        self._deadline = 0
        self._cancelled = False

    def explained(self, error: BaseException) -> Exception:
        """Return the error of a watched call: TimeoutError where it was overdue; raise one that is none of ours."""
        if self._take_back_cancellation(error):
            return TimeoutError(f"no answer within {describe(self._limit)}")
        if not isinstance(error, Exception):
            raise error
        return error

    def close(self) -> None:
        """Stop watching."""
        if self._timer is not None:
            self._timer.cancel()

    def _take_back_cancellation(self, error: BaseException) -> bool:
        if not self._cancelled or not isinstance(error, asyncio.CancelledError):
            return False
        task = asyncio.current_task()
        return task is not None and task.uncancel() == 0

    def _watch(self, delay: int) -> None:
        self.close()
        self._task = self._task or asyncio.current_task()
        self._looks_at = self._now() + delay
        self._timer = self._loop.call_later(delay / 1e9, self._look)

    def _look(self) -> None:
        self._looks_at = NEVER
        if not self._deadline:
            return
        left = self._deadline - self._now()
        if left > 0:
            self._watch(left)
        elif not self._cancelled and self._task is not None:
            self._cancelled = True
            self._task.cancel()
            self._deadline = self._now() + self._limit
            self._watch(self._limit)
        elif not self.stuck.done():
            self.stuck.set_result(self._what)
