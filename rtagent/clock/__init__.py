"""Two clocks behind the same asyncio calls: the real, monotonic one, and a virtual one that jumps.

Code asks `current()` for the clock of the running event loop; nothing below the edges calls `time.*`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Literal, Protocol, TypeVar

from rtagent.clock.real import RealClock, occupy, real_loop
from rtagent.clock.virtual import START, VirtualClock, VirtualLoop, virtual_loop
from rtagent.errors import ClockError

__all__ = [
    "Clock",
    "ClockName",
    "RealClock",
    "VirtualClock",
    "VirtualLoop",
    "current",
    "occupy",
    "ready_counter",
    "real_loop",
    "run",
]

ClockName = Literal["real", "virtual"]
T = TypeVar("T")


class Clock(Protocol):
    """Time in integer nanoseconds, and the processor that computations occupy."""

    virtual: bool
    now: Callable[[], int]

    def suspended(self) -> int:
        """Return how long (ns) the machine has been suspended; only a change of it means anything."""

    async def sleep_until(self, when: int) -> None:
        """Return at `when` (ns), or at once where that has passed."""

    async def compute(self, cost: int) -> None:
        """Occupy the processor for `cost` (ns): really, or as a charge to the virtual clock."""

    async def charge(self, cost: int) -> None:
        """Occupy the virtual processor for `cost` (ns); under the real clock work costs what it costs."""


def current() -> Clock:
    """Return the clock of the running event loop (any asyncio loop will do)."""
    loop = asyncio.get_running_loop()
    return loop.clock if isinstance(loop, VirtualLoop) else RealClock()


def ready_counter() -> Callable[[], int]:
    """Return what counts the callbacks that the running event loop is about to make (1 where it does not tell)."""
    ready = getattr(asyncio.get_running_loop(), "_ready", None)
    return (lambda: 1) if ready is None else ready.__len__


def run(
    main: Coroutine[Any, Any, T],
    clock: ClockName = "real",
    start: int | None = None,
    *,
    make_loop: Callable[[], asyncio.AbstractEventLoop] = real_loop,
) -> T:
    """Run `main` to its end under a clock, as `asyncio.run` does; `make_loop` makes the loop of the real one.

    A virtual clock starts at `start` (ns): by default far from zero and from the machine's own clock, so that
    code that reads the wrong one is found out.
    """
    if asyncio._get_running_loop() is not None:
        main.close()
        raise ClockError("an event loop is running already: write `await run(...)` there, without clock.run.")
    loop = make_loop() if clock == "real" else virtual_loop(START if start is None else start)
    try:
        return loop.run_until_complete(main)
    finally:
        _finish(loop)


def _finish(loop: asyncio.AbstractEventLoop) -> None:
    """Cancel what is left, but wait for it at most a second: a task that will not end must not hang the run."""
    try:
        tasks = asyncio.all_tasks(loop)
        for task in tasks:
            task.cancel()
        if tasks:
            loop.run_until_complete(asyncio.wait(tasks, timeout=1.0))
        loop.run_until_complete(loop.shutdown_asyncgens())
    finally:
        loop.close()
