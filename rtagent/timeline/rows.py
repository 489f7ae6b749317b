"""Rows of integers in preallocated memory: the newest are kept."""

from __future__ import annotations

from array import array
from collections.abc import Iterator

COLUMNS = 5
CAPACITY = 1 << 20

Row = tuple[int, int, int, int, int]
"""A code, and four integers that mean what it says."""


class Rows:
    """A preallocated ring of rows of five integers, each below 2⁶³; keeping a row takes no memory."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._cells = array("q", bytes(8 * COLUMNS * capacity))
        self._capacity = capacity
        self.count = 0

    def append(self, code: int, start: int, end: int, value: int = 0, other: int = 0) -> None:
        """Keep a row; where there is no room, it takes the place of the oldest."""
        cells, at = self._cells, self.count % self._capacity * COLUMNS
        cells[at], cells[at + 1], cells[at + 2], cells[at + 3], cells[at + 4] = code, start, end, value, other
        self.count += 1

    @property
    def dropped(self) -> int:
        """How many rows are not kept any more."""
        return max(0, self.count - self._capacity)

    def __iter__(self) -> Iterator[Row]:
        for number in range(self.dropped, self.count):
            at = number % self._capacity * COLUMNS
            code, start, end, value, other = self._cells[at : at + COLUMNS]
            yield code, start, end, value, other
