"""Distances to prototypes, compiled: many in float32, with a bound on their error, and single ones in float64.

Distances of the Euclidean metric are squares. numba keeps kernels by their own file: after a change here, touch
those that use it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rtagent.kernels.compiling import kernel

EUCLIDEAN, CITY_BLOCK = 0, 1
"""The metrics, by their places in `rtagent.features.prototypes.Distance`; any other number is the third."""
BLOCK = 2048
ROUNDING = 2.0**-24
SAFETY = 2.0

Singles = NDArray[np.float32]
Doubles = NDArray[np.float64]


@kernel(fastmath=True)
def _add_squares(columns: Singles, start: int, end: int, point: Doubles, out: Singles) -> None:
    whole = len(point) - len(point) % 4
    for signal in range(0, whole, 4):
        a, b = columns[signal, start:end], columns[signal + 1, start:end]
        c, d = columns[signal + 2, start:end], columns[signal + 3, start:end]
        u, v = np.float32(point[signal]), np.float32(point[signal + 1])
        w, x = np.float32(point[signal + 2]), np.float32(point[signal + 3])
        for k in range(len(out)):
            p, q, r, s = a[k] - u, b[k] - v, c[k] - w, d[k] - x
            out[k] += p * p + q * q + r * r + s * s
    for signal in range(whole, len(point)):
        a, u = columns[signal, start:end], np.float32(point[signal])
        for k in range(len(out)):
            p = a[k] - u
            out[k] += p * p


@kernel(fastmath=True)
def _add_sides(columns: Singles, start: int, end: int, point: Doubles, out: Singles) -> None:
    for signal in range(len(point)):
        a, u = columns[signal, start:end], np.float32(point[signal])
        for k in range(len(out)):
            out[k] += abs(a[k] - u)


@kernel(fastmath=True)
def _keep_longest(columns: Singles, start: int, end: int, point: Doubles, out: Singles) -> None:
    for signal in range(len(point)):
        a, u = columns[signal, start:end], np.float32(point[signal])
        for k in range(len(out)):
            out[k] = max(out[k], abs(a[k] - u))


@kernel()
def measure(columns: Singles, first: int, last: int, point: Doubles, metric: int) -> None:
    """Put the distances of these columns from the point, in the unit cube, into the row below the signals."""
    for start in range(first, last, BLOCK):
        end = min(start + BLOCK, last)
        out = columns[len(point), start:end]
        out[:] = np.float32(0)
        if metric == EUCLIDEAN:
            _add_squares(columns, start, end, point, out)
        elif metric == CITY_BLOCK:
            _add_sides(columns, start, end, point, out)
        else:
            _keep_longest(columns, start, end, point, out)


@kernel()
def slack(distance: float, signals: int, metric: int) -> float:
    """Return by how much a measured distance of at most this size may differ from that in float64.

    A coordinate of the unit cube is rounded by at most half of 2^-24, and so is the difference of two: a side is
    wrong by three halves. The square of a side errs by twice the side times that, and sums round once a signal.
    """
    side = 1.5 * ROUNDING
    if metric == EUCLIDEAN:
        squares = 2.0 * side * math.sqrt(signals * distance) + signals * side * side
        return SAFETY * (squares + (signals + 1) * ROUNDING * distance)
    if metric == CITY_BLOCK:
        return SAFETY * signals * (side + ROUNDING * distance)
    return SAFETY * side


@kernel()
def distance(one: Doubles, other: Doubles, metric: int) -> float:
    """Return the distance in float64, summed in the order of the signals as the plain form does."""
    total = 0.0
    for signal in range(len(one)):
        side = abs(one[signal] - other[signal])
        if metric == EUCLIDEAN:
            total += side * side
        elif metric == CITY_BLOCK:
            total += side
        else:
            total = max(total, side)
    return total


@kernel()
def length(measured: float, metric: int) -> float:
    """Return a distance for which the triangle inequality holds."""
    return math.sqrt(max(measured, 0.0)) if metric == EUCLIDEAN else measured
