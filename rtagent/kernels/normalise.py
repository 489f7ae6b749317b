"""Normalising, compiled.

numba keeps kernels by their own file: after a change here, touch those that use it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtagent.kernels.compiling import kernel


@kernel()
def to_unit_cube(
    point: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], clips: NDArray[np.int64]
) -> int:
    """Clip a state to its ranges, counting, and normalise it, in place.

    Return -1, or the place of the first signal that is not a number, and then nothing is changed.
    """
    for signal in range(len(point)):
        if np.isnan(point[signal]):
            return signal
    for signal in range(len(point)):
        inside = min(max(point[signal], low[signal]), high[signal])
        clips[signal] += inside != point[signal]
        point[signal] = (inside - low[signal]) / (high[signal] - low[signal])
    return -1
