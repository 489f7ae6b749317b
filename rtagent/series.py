"""Series: preallocated arrays that instruments write to."""

from __future__ import annotations

from array import array

CAPACITY = 1 << 16
"""How many values a series keeps: the newest; its count and maximum are of all."""


LEAST = -(1 << 63)


class Series:
    """A preallocated ring of integers (ns or counts) that knows its true count and maximum."""

    __slots__ = ("_capacity", "_maximum", "_values", "count")

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._values = array("q", bytes(8 * capacity))
        self._capacity = capacity
        self.count = 0
        self._maximum = LEAST

    def record(self, value: int) -> None:
        """Keep one value."""
        self._values[self.count % self._capacity] = value
        self.count += 1
        if value > self._maximum:
            self._maximum = value

    @property
    def maximum(self) -> int:
        """The largest of all values (0 where there are none)."""
        return self._maximum if self.count else 0

    def values(self) -> list[int]:
        """Return the values kept, the oldest first."""
        if self.count <= self._capacity:
            return self._values[: self.count].tolist()
        start = self.count % self._capacity
        return (self._values[start:] + self._values[:start]).tolist()
