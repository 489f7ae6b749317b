"""What goes wrong on an emulated bus, and when."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

from rtagent.errors import SpecError
from rtagent.units import Duration, ms

CLOSED_SETTINGS = {"extra": "forbid"}

Kind = Literal[
    "silent", "corrupt", "truncated", "late", "noise", "babble",
    "overload", "overheat", "voltage", "blocked", "unplug",
]  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong, from `begin` on for `duration` (0: until it is mended), with one servo or all (0).

    Of its answers: `silent` sends none, `corrupt` one with a wrong checksum, `truncated` the first half of one,
    `late` one that comes `delay` later, `noise` one behind random bytes; each with `probability`.
    Of the line: `babble` fills it with random bytes, so that nobody is understood; `unplug` takes the port away.
    Of the servo: `overload`, `overheat` and `voltage` are errors that it reports and acts upon; `blocked` holds its
    joint fast.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    kind: Kind
    servo: int = 0
    begin: Duration = 0
    duration: Duration = 0
    probability: float = 1.0
    delay: Duration = 5 * ms

    def __post_init__(self) -> None:
        if not 0.0 <= self.probability <= 1.0:
            raise SpecError(f"the probability of a fault is {self.probability}: give 0 to 1.")
        if self.begin < 0 or self.duration < 0 or self.delay < 0:
            raise SpecError("begin, duration or delay of a fault is negative: give 0 or more.")

    def concerns(self, servo: int) -> bool:
        """Return whether it goes wrong with this servo."""
        return self.servo in (0, servo)


class Edge(NamedTuple):
    """A moment (ns) at which a fault begins, or ends."""

    time: int
    begins: bool
    fault: Fault


class Plan:
    """Faults in time: those that are to come, and those that are there."""

    def __init__(self, faults: tuple[Fault, ...] = (), start: int = 0) -> None:
        self.present: list[Fault] = []
        self._edges: list[Edge] = []
        for fault in faults:
            self.add(fault, start)

    def add(self, fault: Fault, start: int) -> None:
        """Let a fault happen; its times count from `start` (ns)."""
        begin = start + fault.begin
        self._edges.append(Edge(begin, True, fault))
        if fault.duration:
            self._edges.append(Edge(begin + fault.duration, False, fault))
        self._edges.sort(key=lambda edge: edge.time)

    def mend(self, kind: str, servo: int, now: int) -> None:
        """End what goes wrong in this way (`all`: in any) with this servo, and what was to come of it."""
        ended = [f for f in self.present if kind in ("all", f.kind) and servo in (0, f.servo)]
        kept = [e for e in self._edges if not (kind in ("all", e.fault.kind) and servo in (0, e.fault.servo))]
        self._edges = sorted([*kept, *(Edge(now, False, fault) for fault in ended)], key=lambda edge: edge.time)

    def due(self) -> int | None:
        """Return when (ns) a fault begins or ends next."""
        return self._edges[0].time if self._edges else None

    def advance(self, now: int) -> Iterator[Edge]:
        """Yield what begins and ends until `now`, in order."""
        while self._edges and self._edges[0].time <= now:
            edge = self._edges.pop(0)
            if edge.begins:
                self.present.append(edge.fault)
            elif edge.fault in self.present:
                self.present.remove(edge.fault)
            yield edge

    def of(self, kind: Kind, servo: int) -> Fault | None:
        """Return the fault of this kind that a servo has, or None."""
        return next((f for f in self.present if f.kind == kind and f.concerns(servo)), None)
