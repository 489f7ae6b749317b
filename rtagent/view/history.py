"""The newest past of some signals, in memory that does not grow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

MOST_ROWS = 1 << 17
MOST_BYTES = 64 << 20
"""So much is kept of one table: of few signals 131,072 rows, of many less."""

Times = NDArray[np.int64]
Values = NDArray[np.float32]


class History:
    """A table with a row for each record: times (ns), and the values of `columns`; the oldest rows make room."""

    def __init__(self, columns: Sequence[str]) -> None:
        self.columns = list(columns)
        rows = max(16, min(MOST_ROWS, MOST_BYTES // (4 * max(1, len(columns)))))
        self._times = np.empty(2 * rows, np.int64)
        self._values = np.empty((2 * rows, len(columns)), np.float32)
        self._rows, self._end = rows, 0

    def add(self, time: int, values: Sequence[float | None]) -> None:
        """Add a row; None is kept as not a number. One that is older than the last is taken as of its time."""
        if self._end == 2 * self._rows:
            self._make_room()
        self._times[self._end] = max(time, self._times[self._end - 1]) if self._end else time
        self._values[self._end] = values  # None becomes nan
        self._end += 1

    def _make_room(self) -> None:
        """Move the newer half to the front, so that what is kept is always in one piece."""
        self._times[: self._rows] = self._times[self._rows :]
        self._values[: self._rows] = self._values[self._rows :]
        self._end = self._rows

    @property
    def times(self) -> Times:
        """The times of all rows, shape (rows,), in ns; a view, true until the next row."""
        return self._times[: self._end]

    @property
    def table(self) -> Values:
        """The values of all rows, shape (rows, columns); a view, true until the next row."""
        return self._values[: self._end]

    def column(self, name: str) -> Values:
        """Return the values of a signal, shape (rows,); raise `KeyError` where there is no such signal."""
        try:
            return self.table[:, self.columns.index(name)]
        except ValueError:
            raise KeyError(name) from None
