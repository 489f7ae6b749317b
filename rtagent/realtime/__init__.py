"""Real-time manners: what a run may ask of the machine, and what the machine answers.

    with manners(Realtime(priority=50, gc="calm")) as granted:
        result = granted.run(run(devices, task, agent, schedule))

What is refused is a sentence with its cure in `granted.refused`, and the run goes on without it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable, Coroutine, Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from rtagent import clock
from rtagent.realtime import machine, timeslice
from rtagent.realtime.busy import BusyWatch
from rtagent.realtime.collector import Collector
from rtagent.realtime.machine import RefusedError, Undo
from rtagent.units import describe

__all__ = ["Collector", "Manners", "Realtime", "manners"]

T = TypeVar("T")

BUSY = "the loop never sleeps, and the kernel stops such a loop for 50 ms of each second"
PACE_IT = "give schedule.period a value, or let observe wait for a device that has a rate"


@dataclass(frozen=True)
class Realtime:
    """What is asked of the machine beside a short time slice; by default nothing.

    `priority` is that of SCHED_FIFO, 1 to 99 (0: none); `processors` are those that the loop may run on,
    `learner_processors` those of a thread that learns (none: those of the loop); `switch_interval` (ns) is how long
    a Python thread keeps the GIL from others that want it (0: as it is).
    """

    priority: int = 0
    processors: tuple[int, ...] = ()
    learner_processors: tuple[int, ...] = ()
    gc: Literal["default", "calm"] = "default"
    switch_interval: int = 0
    uvloop: bool = False
    lock_memory: bool = False


class Manners:
    """What a run was granted and what was refused, each a sentence; and the run with it."""

    def __init__(self, clock_name: clock.ClockName = "real") -> None:
        self.granted: list[str] = []
        self.refused: list[str] = []
        self.collector: Collector | None = None
        self._clock = clock_name
        self._make_loop: Callable[[], asyncio.AbstractEventLoop] = clock.real_loop
        self._learner_processors: tuple[int, ...] = ()
        self._give_priority_up: Undo | None = None

    def run(self, main: Coroutine[Any, Any, T]) -> T:
        """Run `main` to its end under the clock, on the event loop that was granted."""
        return clock.run(self._watched(main), self._clock, make_loop=self._make_loop)

    def calm(self) -> None:
        """Collect garbage if some is due: for moments in which nothing is urgent."""
        if self.collector is not None:
            self.collector.calm()

    def place_learner(self) -> None:
        """Move the calling thread to the processors for learning; for that thread to call when it starts."""
        if self._learner_processors:
            os.sched_setaffinity(0, self._learner_processors)

    def as_dict(self) -> dict[str, list[str]]:
        """Return both lists as plain data for JSON."""
        return {"granted": self.granted, "refused": self.refused}

    async def _watched(self, main: Coroutine[Any, Any, T]) -> T:
        if self._give_priority_up is not None:
            BusyWatch(self._found_busy).start()
        return await main

    def _found_busy(self, share: float) -> None:
        if self._give_priority_up is not None:
            self._give_priority_up()
            self._give_priority_up = None
            self.refused.append(
                f"the scheduling priority was given up during the run: the loop was busy {share:.0%} of the time, "
                f"and the kernel stops a loop that is always busy: {PACE_IT}, or learn less."
            )


@contextlib.contextmanager
def manners(realtime: Realtime, clock_name: clock.ClockName = "real", *, busy: bool = False) -> Iterator[Manners]:
    """Ask the machine for a short time slice and for all that `realtime` says, and give everything back afterwards.

    They are those of the calling thread and of threads that it starts, but for the priority, which others never
    inherit. A loop that is `busy`, one that never sleeps, gets no priority.
    """
    made = Manners(clock_name)
    with contextlib.ExitStack() as stack:
        if clock_name == "real":
            _shorten_slice(made, stack)
            for what, ask in _asked(realtime, made, busy):
                _attempt(made, stack, what, ask)
        elif realtime != Realtime():
            made.refused.append("under the virtual clock nothing of [realtime] applies: it is for the real one.")
        yield made


def _shorten_slice(made: Manners, stack: contextlib.ExitStack) -> None:
    """Ask for what costs nobody anything; a system that has no such slices is not told of."""
    give_back = timeslice.short_slice()
    if give_back is not None:
        stack.callback(give_back)
        made.granted.append(f"time slice {describe(timeslice.SHORTEST)}")


def _attempt(made: Manners, stack: contextlib.ExitStack, what: str, ask: Callable[[], Undo]) -> None:
    try:
        stack.callback(ask())
    except RefusedError as refusal:
        made.refused.append(str(refusal))
    else:
        made.granted.append(what)


def _asked(realtime: Realtime, made: Manners, busy: bool) -> Iterator[tuple[str, Callable[[], Undo]]]:
    """Yield what to ask for, each with its name; the priority last, so that nothing long is done under it."""
    if realtime.processors:
        yield _listed(realtime.processors), lambda: machine.bind(realtime.processors)
    if realtime.learner_processors:
        yield f"learning on {_listed(realtime.learner_processors)}", lambda: _learner(realtime, made)
    if realtime.lock_memory:
        yield "memory locked", machine.lock_memory
    if realtime.switch_interval:
        name = f"switch interval {describe(realtime.switch_interval)}"
        yield name, lambda: machine.switch_interval(realtime.switch_interval)
    if realtime.uvloop:
        yield "uvloop", lambda: _uvloop(made)
    if realtime.gc == "calm":
        yield "garbage collected in calm moments", lambda: _calm(made)
    if realtime.priority:
        yield f"scheduling priority {realtime.priority}", lambda: _priority(realtime.priority, made, busy)


def _listed(processors: tuple[int, ...]) -> str:
    return f"processor{'s' * (len(processors) > 1)} {', '.join(map(str, processors))}"


def _learner(realtime: Realtime, made: Manners) -> Undo:
    machine.refuse_absent(realtime.learner_processors)
    made._learner_processors = realtime.learner_processors
    return lambda: None


def _uvloop(made: Manners) -> Undo:
    made._make_loop = machine.uvloop_maker()
    return lambda: None


def _calm(made: Manners) -> Undo:
    made.collector = Collector()
    return made.collector.close


def _priority(priority: int, made: Manners, busy: bool) -> Undo:
    if busy:
        raise RefusedError(f"the scheduling priority {priority} is not asked for: {BUSY}; {PACE_IT}.")
    made._give_priority_up = machine.fifo(priority)
    return made._give_priority_up
