"""Series: preallocated arrays that instruments write to."""

from __future__ import annotations

from array import array

import numpy as np

from rtagent.errors import SpecError
from rtagent.saving import Saved

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

    def save(self) -> Saved:
        """Return the ring as it is, with the count and the maximum of all."""
        kept = min(self.count, self._capacity)
        ring = np.frombuffer(self._values, np.int64, kept).copy() if kept else np.empty(0, np.int64)
        return {"ring": ring, "count": self.count, "maximum": self._maximum}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where more was kept than has room here."""
        ring = saved["ring"]
        if len(ring) > self._capacity:
            raise SpecError(f"a saved series keeps {len(ring)} values, this one {self._capacity}.")
        self._values[: len(ring)] = array("q", ring.tobytes())
        self.count, self._maximum = saved["count"], saved["maximum"]
