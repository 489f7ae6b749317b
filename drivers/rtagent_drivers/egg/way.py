"""A joint's way as a function of time: to a speed, at a constant acceleration, and on at it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import ceil, inf

from rtagent.units import second
from rtagent_drivers.dynamixel.steps import Body, Step, Turn

FREE = Body()
ROUNDED = 4
"""By less than so much (ns) rounding may move a time."""


class Way:
    """A joint that has been at rest at 0 since `start` (ns), and is told speeds (rad/s, 0 or more) from moments on.

    It never goes beyond `end` (rad). Nothing here depends on when it is asked.
    """

    def __init__(self, start: int, acceleration: float, end: float) -> None:
        self._acceleration, self._end = acceleration, end
        self._starts: list[int] = [start]
        self._steps: list[Step] = [Step(inf, 0.0, 0.0)]
        self.speed = 0.0
        """The newest that it was told."""

    def turn(self, now: int, speed: float) -> None:
        """Let it go over to `speed` from `now` on; what was to come then no longer does."""
        position, velocity = self.at(now)
        kept = bisect_right(self._starts, now - 1)
        del self._starts[kept:], self._steps[kept:]
        self.speed, when = speed, float(now)
        for step in Turn(speed, self._acceleration).plan(FREE, position, velocity):
            self._starts.append(ceil(when))
            self._steps.append(step)
            when += step.duration * second

    def at(self, time: int) -> tuple[float, float]:
        """Return position (rad) and velocity (rad/s) at `time`; before the start they are those of the start."""
        place = max(0, bisect_right(self._starts, time) - 1)
        step = self._steps[place]
        position, velocity = step.after(max(0, time - self._starts[place]) / second)
        return (position, velocity) if position < self._end else (self._end, 0.0)

    def reaches(self, position: float) -> int | None:
        """Return when (ns) it is at `position` or beyond for the first time, or None where it never is."""
        if position > self._end:
            return None
        for place, (start, step) in enumerate(zip(self._starts, self._steps, strict=True)):
            elapsed = step.leaves(position, 1.0)
            when = None if elapsed is None else start + ceil(elapsed * second)
            if when is not None and (place + 1 == len(self._starts) or when <= self._starts[place + 1]):
                return self._first_near(when, position)
        return None

    def _first_near(self, when: int, position: float) -> int:
        """Return the first time (ns) about `when` at which `at` finds it there: both are rounded."""
        nearby = range(when - ROUNDED, when + ROUNDED)
        return next((time for time in nearby if self.at(time)[0] >= position), when)

    def settles(self) -> int:
        """Return when (ns) it has the newest speed that it was told."""
        return self._starts[-1]

    def save(self) -> dict[str, Sequence[object]]:
        """Return all of it."""
        return {"starts": list(self._starts), "steps": [list(step) for step in self._steps], "speed": [self.speed]}

    def restore(self, saved: dict[str, Sequence[object]]) -> None:
        """Take what `save` returned."""
        self._starts[:] = saved["starts"]  # type: ignore[assignment]  # what was saved is of these types
        self._steps[:] = [Step(*step) for step in saved["steps"]]  # type: ignore[misc]
        (self.speed,) = saved["speed"]  # type: ignore[assignment]
