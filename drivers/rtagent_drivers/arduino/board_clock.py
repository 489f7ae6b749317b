"""A board's clock, fitted to the host's: when by the host's clock a sample was taken, not when it arrived.

What arrives is never early. So, seen over the board's time, the lowest of the arrival times lie on a line, the
board's drift is its slope, and how much later than it a sample arrived is that sample's delay. The line is the edge
of the lower convex hull that spans the middle of the last minute (Zhang, Liu and Xia 2002, "Clock synchronization
algorithms for network measurements", INFOCOM).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from rtagent.units import ms, second, us

WRAP = 1 << 32
MOST_DRIFT = 0.01
"""Ceramic resonators are within half a percent."""

FINEST, COARSEST, MOST_STRETCHES = 50 * ms, second, 60
"""Of each stretch of time the sample that came soonest is kept; stretches grow until they cover a minute."""

LOST_TIME, FOR_SO_LONG = 20 * ms, 2 * second
"""A board whose every sample is later than this, for so long, has stood still meanwhile."""


class Point(NamedTuple):
    """A sample: the board's time since the first one (ns), and how much later it arrived by the host's (ns)."""

    time: int
    offset: int


class BoardClock:
    """The fit. `latency` (ns) is how long a sample takes to the host at least; times in ns."""

    def __init__(self, latency: int = 0) -> None:
        self.latency = latency
        self._first: int | None = None
        self._restart(0)

    def unwrapped(self, micros: int) -> int:
        """Return the board's time (ns) since the first sample, from its 32 bits of µs."""
        if self._first is None:
            self._first = self._last = micros
        self._last += (micros - self._last) % WRAP
        return (self._last - self._first) * us

    def hear(self, time: int, arrival: int) -> None:
        """Take when a sample of the board's `time` arrived."""
        point = Point(time, arrival - time)
        late = point.offset - self._offset(time) if self._points else 0
        if late < 0 or not self._points:
            self._base += late if self._points else point.offset - self._base
        self._keep(point)
        if late < LOST_TIME:
            self._in_time_at = time
        elif time - self._in_time_at > FOR_SO_LONG:
            self._restart(time)
            self.hear(time, arrival)

    def at(self, time: int) -> int:
        """Return the host's time at a time of the board's."""
        return time + round(self._offset(time)) - self.latency

    @property
    def drift(self) -> float:
        """By how much the host's clock is faster than the board's, such as 0.0001."""
        return self._slope

    def _restart(self, time: int) -> None:
        self._points: list[Point] = []
        self._stretch, self._stretch_began = FINEST, time
        self._slope, self._base, self._origin = 0.0, 0.0, time
        self._in_time_at = time

    def _offset(self, time: int) -> float:
        return self._base + self._slope * (time - self._origin)

    def _keep(self, point: Point) -> None:
        if not self._points or point.time - self._stretch_began >= self._stretch:
            if self._points:
                self._fit()
            self._stretch_began = point.time
            self._make_room()
            self._points.append(point)
        elif (
            point.offset - self._slope * point.time < self._points[-1].offset - self._slope * self._points[-1].time
        ):
            self._points[-1] = point

    def _make_room(self) -> None:
        if len(self._points) < MOST_STRETCHES:
            return
        if self._stretch >= COARSEST:
            del self._points[0]
            return
        self._stretch *= 2
        pairs = zip(self._points[::2], self._points[1::2], strict=True)
        self._points = [min(pair, key=lambda point: point.offset - self._slope * point.time) for pair in pairs]

    def _fit(self) -> None:
        left, right = _spanning(_lower_hull(self._points), self._points)
        run = right.time - left.time
        slope = (right.offset - left.offset) / run if run else 0.0
        self._slope = min(max(slope, -MOST_DRIFT), MOST_DRIFT)
        self._origin = left.time
        self._base = min(point.offset - self._slope * (point.time - self._origin) for point in self._points)


def _lower_hull(points: Sequence[Point]) -> list[Point]:
    """Return the corners of the lower convex hull of points in the order of their times (Andrew 1979)."""
    hull: list[Point] = []
    for point in points:
        while len(hull) > 1 and _turns_down(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    return hull


def _turns_down(first: Point, second: Point, third: Point) -> bool:
    return (second.offset - first.offset) * (third.time - first.time) >= (third.offset - first.offset) * (
        second.time - first.time
    )


def _spanning(hull: Sequence[Point], points: Sequence[Point]) -> tuple[Point, Point]:
    """Return the edge of the hull at the mean of the times: the line below all points that is nearest to them."""
    mean = sum(point.time for point in points) / len(points)
    for left, right in pairwise(hull):
        if right.time >= mean:
            return left, right
    return hull[-1], hull[-1]
