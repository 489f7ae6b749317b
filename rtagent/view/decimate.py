"""As many points as a plot can show, and no peak less: least and greatest of every column of pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent.view.history import Times, Values


class Grid(NamedTuple):
    """Columns of pixels: the first begins at `first` (ns), each is `width` (ns) wide."""

    first: int
    width: int
    columns: int

    @property
    def edges(self) -> Times:
        """Where they begin, and the last ends: shape (columns + 1,), in ns."""
        return self.first + self.width * np.arange(self.columns + 1, dtype=np.int64)


def grid(begin: int, end: int, columns: int) -> Grid:
    """Return a grid that covers begin to end (ns), at multiples of its width, so that what moves on stays."""
    width = max(1, -(-(end - begin) // max(1, columns)))
    first = begin // width
    return Grid(first * width, width, -(-end // width) - first)


def decimate(times: Times, values: Values, grid: Grid) -> NDArray[np.float32]:
    """Return two values for each column of `grid`, shape (2 * columns,): the least and the greatest.

    They come in the order in which they were; in a column without a value both are not a number.
    """
    places = np.searchsorted(times, grid.edges)
    filled = np.flatnonzero(places[1:] > places[:-1])
    out = np.full((grid.columns, 2), np.nan, np.float32)
    if not filled.size:
        return out.ravel()
    inside, starts = values[: places[-1]], places[filled]
    if (places[filled + 1] - starts).max() == 1:
        out[filled] = inside[starts, np.newaxis]
    else:
        least, greatest = np.fmin.reduceat(inside, starts), np.fmax.reduceat(inside, starts)
        rising = inside[starts] <= inside[places[filled + 1] - 1]
        out[filled, 0] = np.where(rising, least, greatest)
        out[filled, 1] = np.where(rising, greatest, least)
    return out.ravel()
