"""The learning rule of a schedule, as data: when learning runs, in what slices, where, and how much may wait."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

from rtagent.errors import ScheduleError


class When(StrEnum):
    """Whether learning always runs, or only while the newest observation is not urgent."""

    ALWAYS = "always"
    CALM = "calm"


class Where(StrEnum):
    """Whether learning runs on the event loop, or on a thread of its own."""

    LOOP = "loop"
    THREAD = "thread"


class Full(StrEnum):
    """What becomes of a transition that finds the queue full.

    `block`: the oldest is learned at once. `shed`: the newest is dropped, and traces are cut there.
    """

    BLOCK = "block"
    SHED = "shed"


@dataclass(frozen=True)
class Condition:
    """Urgent while a sensor (`signal`: "device.sensor") or a demon's `prediction` is `above` or `below` a value."""

    signal: str = ""
    prediction: str = ""
    above: float = math.inf
    below: float = -math.inf

    def __post_init__(self) -> None:
        if bool(self.signal) == bool(self.prediction):
            raise ScheduleError('learn.urgent needs either signal = "device.sensor" or prediction = "demon".')
        if math.isinf(self.above) and math.isinf(self.below):
            raise ScheduleError("learn.urgent has no bound: give above or below a value.")

    def holds(self, value: float) -> bool:
        """Say whether a value is urgent."""
        return value > self.above or value < self.below


@dataclass(frozen=True)
class Learn:
    """When, in what slices (ns; 0: in one piece) and where transitions are learned, first in, first out.

    At most `queue` transitions wait; `full` says what then becomes of another one. Without `urgent` the task says
    which states are urgent.
    """

    when: When = When.ALWAYS
    slice: int = 0
    where: Where = Where.LOOP
    queue: int = 1000
    full: Full = Full.BLOCK
    urgent: Condition | None = None

    def __post_init__(self) -> None:
        for name, kind in (("when", When), ("where", Where), ("full", Full)):
            value = getattr(self, name)
            if value not in list(kind):
                raise ScheduleError(f"learn.{name} is {value!r}: use one of {', '.join(kind)}.")
            object.__setattr__(self, name, kind(value))
        if self.slice < 0:
            raise ScheduleError("learn.slice is negative: give a time, or 0 for none.")
        if self.where is Where.THREAD and (self.slice or self.when is When.CALM):
            raise ScheduleError(
                'a thread learns all the time, and in the pieces that its learner has: with learn.where = "thread" '
                'set learn.when = "always" and learn.slice = 0.'
            )
        if self.queue < 1:
            raise ScheduleError(f"learn.queue is {self.queue}: give room for 1 transition or more.")

    @property
    def inline(self) -> bool:
        """Whether every transition is learned as soon as the schedule comes to it, in one piece."""
        return self.when is When.ALWAYS and not self.slice and self.where is Where.LOOP
