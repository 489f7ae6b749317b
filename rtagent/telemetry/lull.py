"""When the loop of a run rests: what telemetry does then makes no cycle late, also where a core is shared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

GUARD = 0.4
"""For so much of the period before a cycle nothing is begun: what was handed on is still being passed on then."""
LONGEST = 20_000_000
"""Up to this period (ns) lulls are waited for, so that nothing is told later by more than it."""
FADING = 0.9
"""How much of the longest that was seen still counts at the next look."""


class Pace(msgspec.Struct, frozen=True):
    """How a run is paced: its period (ns; 0: not at all), and the component that a cycle begins with."""

    period: int = 0
    first: str = ""


class Lull:
    """Knows when the loop of a run rests, from what its cycles told. Times are in ns.

    What is done in its lulls tells by `took` how long a piece of it was.
    """

    def __init__(self, pace: Pace) -> None:
        self._period, self._first = pace.period if pace.period <= LONGEST else 0, pace.first
        self._last_call = (1.0 - GUARD) * self._period
        self._began = self._ended = 0
        self._busy = self._piece = 0.0

    def heard(self, calls: Sequence[tuple[str, Sequence[Any]]]) -> None:
        """Take from the calls of a cycle when the loop was busy."""
        for name, args in calls:
            if name == "component":
                component, began, ended = args
                if component == self._first:
                    self._busy = max(float(self._ended - self._began), FADING * self._busy)
                    self._began = began
                self._ended = ended

    def took(self, time: int) -> None:
        """Take how long a piece of what is done in lulls was."""
        self._piece = max(float(time), FADING * self._piece)

    @property
    def known(self) -> bool:
        """Whether there are lulls that have room for a piece."""
        return bool(self._began) and self._last_call > self._busy + self._piece

    def until(self, now: int) -> int:
        """Return how long it is until a piece may begin: 0 in a lull, and where none is known.

        Each look in vain lets what was longest count less: a single long piece must not leave none its room.
        """
        wait = self._wait((now - self._began) % self._period) if self.known else 0
        if wait:
            self._busy, self._piece = FADING * self._busy, FADING * self._piece
        return wait

    def _wait(self, phase: int) -> int:
        if phase < self._busy:
            return int(self._busy - phase)
        if phase > self._last_call - self._piece:
            return int(self._period - phase + self._busy)
        return 0
