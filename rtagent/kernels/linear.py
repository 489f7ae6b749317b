"""Linear values under one eligibility trace, touching only what is active: the lazy form of `DenseTraces`.

Weights and trace are kept as θ = u + shift·ê and e = scale·ê, so that a decay of the whole trace and a step of
all weights along it are two multiplications. Where ê changes, u makes up for it.

All is in one array, because each array more makes a call slower: cells of shape (weights + 1, 4). A cell has u, ê,
whether it is in the support (the cells whose ê may differ from 0), and a place for one number of the support's
list; the last cell has scale, shift and the length of that list.
An index out of range, or what is not finite, changes nothing and returns what is not finite.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rtagent.experience import FloatArray
from rtagent.kernels.compiling import kernel

U, TRACE, INSIDE, SUPPORT = 0, 1, 2, 3
SCALE, SHIFT, COUNT = 0, 1, 2
SMALLEST_SCALE = 1e-4
"""Below it the support is folded: ê has grown by its inverse, and with it the rounding of u."""
NEGLIGIBLE = 1e-16
"""What of the trace is smaller than this, relative to its largest entry, is forgotten in a fold."""

_FEATURES = "float64[:,::1], int64, int64, int64[::1], float64[::1]"


@kernel(f"UniTuple(float64, 2)({_FEATURES})")
def products(cells: Any, row: int, size: int, indices: Any, values: Any) -> tuple[float, float]:
    """Return u·φ and ê·φ of one row; `values` is empty where all are 1."""
    first = row * size
    if first < 0 or first + size >= cells.shape[0] or not (values.size == 0 or values.size == indices.size):
        return math.nan, math.nan
    u = trace = 0.0
    for k in range(indices.size):
        i = indices[k]
        if i < 0 or i >= size:
            return math.nan, math.nan
        phi = values[k] if values.size else 1.0
        u += cells[first + i, U] * phi
        trace += cells[first + i, TRACE] * phi
    return u, trace


@kernel(f"float64({_FEATURES})")
def value(cells: Any, row: int, size: int, indices: Any, values: Any) -> Any:
    """Return θ·φ of one row."""
    u, trace = products(cells, row, size, indices, values)
    return u + cells[-1, SHIFT] * trace


@kernel("float64[::1](float64[:,::1], int64, int64[::1], float64[::1])")
def all_values(cells: Any, size: int, indices: Any, values: Any) -> FloatArray:
    """Return θ·φ of every row."""
    found = np.empty((cells.shape[0] - 1) // size)
    for row in range(found.size):
        found[row] = value(cells, row, size, indices, values)
    return found


@kernel("void(float64[:,::1])")
def fold(cells: Any) -> None:
    """Write scale and shift into the cells of the support; forget those whose trace is negligible."""
    scale, shift, count = cells[-1, SCALE], cells[-1, SHIFT], int(cells[-1, COUNT])
    largest = 0.0
    for k in range(count):
        i = int(cells[k, SUPPORT])
        cells[i, U] += shift * cells[i, TRACE]
        cells[i, TRACE] *= scale
        largest = max(largest, abs(cells[i, TRACE]))
    kept = 0
    for k in range(count):
        i = int(cells[k, SUPPORT])
        if abs(cells[i, TRACE]) > NEGLIGIBLE * largest:
            cells[kept, SUPPORT] = i
            kept += 1
        else:
            cells[i, TRACE] = cells[i, INSIDE] = 0.0
    cells[-1, SCALE], cells[-1, SHIFT], cells[-1, COUNT] = 1.0, 0.0, kept


@kernel("void(float64[:,::1], float64, float64)")
def move(cells: Any, step: float, decay: float) -> None:
    """Do θ ← θ + step·e, then e ← decay·e; fold where the scale has become small."""
    cells[-1, SHIFT] += step * cells[-1, SCALE]
    cells[-1, SCALE] *= decay
    if cells[-1, SCALE] < SMALLEST_SCALE:
        fold(cells)


@kernel(f"void({_FEATURES}, float64, float64)")
def add(cells: Any, row: int, size: int, indices: Any, values: Any, to_trace: float, to_weights: float) -> None:
    """Do ê ← ê + to_trace·φ and θ ← θ + to_weights·φ."""
    to_u = to_weights - cells[-1, SHIFT] * to_trace
    count = int(cells[-1, COUNT])
    for k in range(indices.size):
        i = row * size + indices[k]
        phi = values[k] if values.size else 1.0
        cells[i, U] += to_u * phi
        cells[i, TRACE] += to_trace * phi
        if cells[i, INSIDE] == 0.0:
            cells[i, INSIDE] = 1.0
            cells[count, SUPPORT] = i
            count += 1
    cells[-1, COUNT] = count


@kernel("void(float64[:,::1], int64, int64, int64[::1])")
def clear(cells: Any, row: int, size: int, indices: Any) -> None:
    """Set the trace of what is active to 0, and leave θ as it is."""
    for k in range(indices.size):
        i = row * size + indices[k]
        cells[i, U] += cells[-1, SHIFT] * cells[i, TRACE]
        cells[i, TRACE] = 0.0


@kernel(f"float64({_FEATURES}, float64, float64, float64, boolean)")
def credit(
    cells: Any, row: int, size: int, indices: Any, values: Any,
    target: float, alpha: float, decay: float, replacing: bool,
) -> Any:  # fmt: skip
    """Add φ to the trace, or replace it there; do θ ← θ + αδe, then e ← decay·e; return δ."""
    delta = target - value(cells, row, size, indices, values)
    if not math.isfinite(delta):
        return delta
    if replacing:
        clear(cells, row, size, indices)
    add(cells, row, size, indices, values, 1.0 / cells[-1, SCALE], 0.0)
    move(cells, alpha * delta, decay)
    return delta


@kernel(f"float64({_FEATURES}, float64, float64, float64, float64)")
def dutch(
    cells: Any, row: int, size: int, indices: Any, values: Any,
    target: float, estimate: float, alpha: float, decay: float,
) -> Any:  # fmt: skip
    """Do one step of true online TD(λ), whose trace holds α, then e ← decay·e; return δ.

    `estimate` is the value that the step before gave to this state, NaN before the first.
    """
    u, trace = products(cells, row, size, indices, values)
    now = u + cells[-1, SHIFT] * trace
    before = now if math.isnan(estimate) else estimate
    delta = target - before
    if not math.isfinite(delta + now):
        return math.nan
    to_trace = alpha * (1.0 / cells[-1, SCALE] - trace)
    add(cells, row, size, indices, values, to_trace, alpha * (before - now))
    move(cells, delta, decay)
    return delta
