"""The virtual clock: an event loop with no selector, whose time jumps to the next timer.

Time is an integer number of nanoseconds, and timers of the same time fire in the order in which they were set,
so that a run is the same every time.
"""

from __future__ import annotations

import asyncio
import heapq
import sys
from collections import deque
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator
from contextvars import Context
from math import inf
from typing import Any, NoReturn, TypeVar, TypeVarTuple
from weakref import WeakSet

from rtagent.errors import ClockError, RunStuckError

START = 1_000_000 * 1_000_000_000
"""A million seconds: far from zero; half a nanosecond is still told apart in a float of seconds."""

Ts = TypeVarTuple("Ts")
T = TypeVar("T")


class VirtualLoop(asyncio.AbstractEventLoop):
    """An asyncio loop in virtual time. What would wait for the real world is refused with a sentence."""

    def __init__(self, start: int = START) -> None:
        self.now = start
        self._ready: deque[asyncio.Handle] = deque()
        self._timers: list[tuple[int, int, asyncio.TimerHandle]] = []
        self._sequence = 0
        self._running = self._stopping = self._closed = False
        self._debug = False
        self._task_factory: Any = None
        self._exception_handler: Any = None
        self._generators: WeakSet[AsyncGenerator[Any, Any]] = WeakSet()
        self.clock = VirtualClock(self)

    # Time

    def time(self) -> float:
        """Return the virtual time in seconds."""
        return self.now / 1e9

    def next_timer(self) -> int | None:
        """Return when (ns) the next timer fires, or None where there is none."""
        while self._timers and self._timers[0][2].cancelled():
            heapq.heappop(self._timers)
        return self._timers[0][0] if self._timers else None

    def advance(self, until: int) -> bool:
        """Jump to `until` (ns) at once if nothing else would happen before; say whether that was so."""
        following = self.next_timer()
        if self._ready or self._stopping or (following is not None and following <= until):
            return False
        self.now = max(self.now, until)
        return True

    # Callbacks

    def call_soon(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.Handle:
        """Call `callback` in the next round."""
        self._check_closed()
        handle = asyncio.Handle(callback, args, self, context)
        self._ready.append(handle)
        return handle

    call_soon_threadsafe = call_soon

    def call_later(
        self,
        delay: float,
        callback: Callable[[*Ts], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        """Call `callback` after `delay` seconds."""
        if delay == inf:
            return self._never(callback, *args, context=context)
        return self.call_at_ns(self.now + round(delay * 1e9), callback, *args, context=context)

    def call_at(
        self,
        when: float,
        callback: Callable[[*Ts], object],
        *args: *Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        """Call `callback` when `time()` is `when`, in seconds."""
        if when == inf:
            return self._never(callback, *args, context=context)
        return self.call_at_ns(round(when * 1e9), callback, *args, context=context)

    def _never(
        self, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """Return a timer that will not fire, and is not waited for."""
        return asyncio.TimerHandle(inf, callback, args, self, context)

    def call_at_ns(
        self, when: int, callback: Callable[[*Ts], object], *args: *Ts, context: Context | None = None
    ) -> asyncio.TimerHandle:
        """Call `callback` when the virtual time is `when`, in ns."""
        self._check_closed()
        handle = asyncio.TimerHandle(when / 1e9, callback, args, self, context)
        self._sequence += 1
        heapq.heappush(self._timers, (when, self._sequence, handle))
        return handle

    def _timer_handle_cancelled(self, handle: asyncio.TimerHandle) -> None:
        """Leave a cancelled timer in the heap; it is dropped when its time comes."""

    def create_future(self) -> asyncio.Future[Any]:
        """Return a future of this loop."""
        return asyncio.Future(loop=self)

    def create_task(
        self, coro: Generator[Any, None, Any] | Coroutine[Any, Any, Any], **settings: Any
    ) -> asyncio.Task[Any]:
        """Return a task of this loop."""
        self._check_closed()
        if self._task_factory is not None:
            made: asyncio.Task[Any] = self._task_factory(self, coro, **settings)
            return made
        return asyncio.Task(coro, loop=self, **settings)

    def run_in_executor(self, executor: Any, func: Callable[[*Ts], T], *args: *Ts) -> asyncio.Future[T]:
        """Call `func` at once: under the virtual clock there is no other thread to wait for."""
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    # Running

    def run_forever(self) -> None:
        """Run until `stop()`; raise `RunStuckError` where nothing would ever happen again."""
        self._check_closed()
        if self._running:
            raise RuntimeError("this event loop is already running")
        if asyncio._get_running_loop() is not None:
            raise RuntimeError("another event loop is running in this thread")
        self._running = True
        hooks = sys.get_asyncgen_hooks()
        sys.set_asyncgen_hooks(firstiter=self._generators.add, finalizer=self._abandoned)
        asyncio._set_running_loop(self)
        try:
            while not self._stopping:
                self._run_once()
        finally:
            self._running = self._stopping = False
            asyncio._set_running_loop(None)
            sys.set_asyncgen_hooks(*hooks)

    def _abandoned(self, generator: AsyncGenerator[Any, Any]) -> None:
        self._generators.discard(generator)
        if not self._closed:
            self.create_task(generator.aclose())

    def run_until_complete(self, future: Any) -> Any:
        """Run until `future` is done and return its result."""
        task = asyncio.ensure_future(future, loop=self)
        task.add_done_callback(self._stop_after)
        try:
            self.run_forever()
        finally:
            task.remove_done_callback(self._stop_after)
        return task.result()

    def _stop_after(self, done: object) -> None:
        self.stop()

    def _run_once(self) -> None:
        ready, timers = self._ready, self._timers
        if not ready or (timers and timers[0][0] <= self.now):
            self._fire_timers()
        for _ in range(len(ready)):
            handle = ready.popleft()
            if not handle._cancelled:  # as asyncio's own loop does: cancelled() costs a call
                handle._run()

    def _fire_timers(self) -> None:
        when = self.next_timer()
        if when is None and self._ready:
            return
        if when is None:
            raise RunStuckError(
                "nothing is left to happen: every task waits for something that nothing will bring about. "
                "Under the virtual clock wait for time to pass, or for an event of a fake device."
            )
        if not self._ready:
            self.now = max(self.now, when)
        while self._timers and self._timers[0][0] <= self.now:
            self._ready.append(heapq.heappop(self._timers)[2])

    def stop(self) -> None:
        """Return from `run_forever` after the present round."""
        self._stopping = True

    def is_running(self) -> bool:
        """Say whether the loop runs."""
        return self._running

    def is_closed(self) -> bool:
        """Say whether the loop was closed."""
        return self._closed

    def close(self) -> None:
        """Drop all that was still to come."""
        self._closed = True
        self._ready.clear()
        self._timers.clear()

    def _check_closed(self) -> None:
        if self._closed:
            raise RuntimeError("the event loop is closed")

    async def shutdown_asyncgens(self) -> None:
        """Close the generators that were begun and not ended."""
        left = list(self._generators)
        self._generators.clear()
        await asyncio.gather(*(generator.aclose() for generator in left), return_exceptions=True)

    def set_default_executor(self, executor: object) -> None:
        """Do nothing: what would be run in a thread is run at once."""

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:  # noqa: ASYNC109  # asyncio names it so
        """Do nothing: there is no executor."""

    # Settings

    def get_debug(self) -> bool:
        """Say whether asyncio's debug mode is on."""
        return self._debug

    def set_debug(self, enabled: bool) -> None:
        """Set asyncio's debug mode."""
        self._debug = enabled

    def get_task_factory(self) -> Any:
        """Return what makes tasks, or None."""
        return self._task_factory

    def set_task_factory(self, factory: Any) -> None:
        """Set what makes tasks."""
        self._task_factory = factory

    def get_exception_handler(self) -> Any:
        """Return what is told of exceptions in callbacks, or None."""
        return self._exception_handler

    def set_exception_handler(self, handler: Any) -> None:
        """Set what is told of exceptions in callbacks."""
        self._exception_handler = handler

    def default_exception_handler(self, context: dict[str, Any]) -> None:
        """Log an exception that nobody awaited."""
        import logging

        logging.getLogger("asyncio").error(context["message"], exc_info=context.get("exception"))

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Hand an exception to the handler that was set, or log it."""
        if self._exception_handler is None:
            self.default_exception_handler(context)
        else:
            self._exception_handler(self, context)


def _refuse(name: str) -> Callable[..., NoReturn]:
    def refused(self: VirtualLoop, *args: object, **kwargs: object) -> NoReturn:
        raise ClockError(
            f"{name} needs the real world, which does not wait for a virtual clock: "
            "run with --clock real, or use a fake that lives in the process."
        )

    refused.__name__ = name
    return refused


REFUSED = [
    "add_reader",
    "remove_reader",
    "add_writer",
    "remove_writer",
    "create_connection",
    "create_server",
    "create_datagram_endpoint",
    "create_unix_connection",
    "create_unix_server",
    "connect_accepted_socket",
    "connect_read_pipe",
    "connect_write_pipe",
    "sock_recv",
    "sock_recv_into",
    "sock_recvfrom",
    "sock_recvfrom_into",
    "sock_sendall",
    "sock_sendto",
    "sock_connect",
    "sock_accept",
    "sock_sendfile",
    "sendfile",
    "start_tls",
    "subprocess_exec",
    "subprocess_shell",
    "getaddrinfo",
    "getnameinfo",
    "add_signal_handler",
    "remove_signal_handler",
]
for _name in REFUSED:
    setattr(VirtualLoop, _name, _refuse(_name))


def virtual_loop(start: int = START) -> VirtualLoop:
    """Return a loop whose time begins at `start` (ns)."""
    return VirtualLoop(start)  # type: ignore[abstract]  # what it refuses was added by name


class VirtualClock:
    """The time of a virtual loop, and one processor that computations occupy one after the other."""

    virtual = True

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop
        self._busy_until = 0
        self.now: Callable[[], int] = lambda: loop.now

    def suspended(self) -> int:
        """Return 0: virtual time is never suspended."""
        return 0

    async def sleep_until(self, when: int) -> None:
        """Return at `when` (ns), or at once where that has passed."""
        loop = self._loop
        if when <= loop.now:
            return
        wake = loop.create_future()
        timer = loop.call_at_ns(when, _wake, wake)
        try:
            await wake
        finally:
            timer.cancel()

    async def compute(self, cost: int) -> None:
        """Occupy the processor for `cost` (ns) while the world's events fire at their own times."""
        start = max(self._loop.now, self._busy_until)
        self._busy_until = start + cost
        if not self._loop.advance(self._busy_until):
            await self.sleep_until(self._busy_until)

    charge = compute

    def go_on_from(self, time: int) -> None:
        """Jump to `time` (ns), before anything waits: a run goes on from there."""
        self._loop.now = max(time, self._busy_until)


def _wake(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
