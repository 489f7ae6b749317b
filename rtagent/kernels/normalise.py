"""Normalising, compiled.

numba keeps kernels by their own file: after a change here, touch those that use it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtagent.kernels.compiling import kernel

READ_ONLY = "Array(float64, 1, 'C', True)"
"""The type of a state: an array that may, or may not, be written to."""


@kernel()
def to_unit_cube(state: NDArray[np.float64], ranges: NDArray[np.float64], clips: NDArray[np.int64]) -> int:
    """Clip a state to its ranges, the first rows of `ranges`, counting; put it in the unit cube, the third row.

    Return -1, or the place of the first signal that is not a number, or that is one too many or the first that
    is missing; then nothing is changed.
    """
    if len(state) != ranges.shape[1]:
        return min(len(state), int(ranges.shape[1]))
    for signal in range(len(state)):
        if np.isnan(state[signal]):
            return signal
    for signal in range(len(state)):
        low, high = ranges[0, signal], ranges[1, signal]
        inside = min(max(state[signal], low), high)
        clips[signal] += inside != state[signal]
        ranges[2, signal] = (inside - low) / (high - low)
    return -1
