"""Linear values under one eligibility trace, touching only what is active: the lazy form of `DenseTraces`.

Weights and trace are kept as θ = u + shift·ê and e = scale·ê, so that a decay of the whole trace and a step of
all weights along it are two multiplications. Where ê changes, u makes up for it. When the scale has become small,
both are folded into the cells, a block at a time; until all are, those that were have another mark than the rest.
θ is computed as a fold does it, so that how far a fold has come changes no bit of a prediction.

All is in one array, because each array more makes a call slower: cells of shape (weights + 2, 4). A cell has u, ê,
its mark (0: not in the support, which are the cells whose ê may differ from 0), and a place for one number of the
support's list. The last two cells have the numbers that are there once.
An index out of range, or what is not finite or has grown beyond all bounds, changes nothing; what is returned is
not finite then.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rtagent.experience import FloatArray
from rtagent.kernels.compiling import kernel
from rtagent.learning.linear import BOUND

U, TRACE, MARK, SUPPORT = 0, 1, 2, 3
SCALE, SHIFT, COUNT, CURRENT = 0, 1, 2, 3
"""Of the last cell: with the length of the support's list, and the mark of cells that scale and shift apply to."""
FOLDED, KEPT, LARGEST, LARGEST_BEFORE = 0, 1, 2, 3
"""Of the last cell but one: how far a fold has come (-1: there is none), how much of the support it kept, the
largest entry of the trace that it met, and that of the fold before."""
SMALLEST_SCALE = 1e-4
"""Below it the support is folded: ê has grown by its inverse, and with it the rounding of u."""
NEGLIGIBLE = 1e-16
"""What of the trace is smaller than this, relative to the largest entry of the fold before, is forgotten."""
BLOCK = 4096
"""So many cells are folded at once: about 12 µs, and 60 µs where they lie scattered over much memory."""

_FEATURES = "float64[:,::1], int64, int64, int64[::1], float64[::1]"


@kernel(f"UniTuple(float64, 2)({_FEATURES})")
def products(cells: Any, row: int, size: int, indices: Any, values: Any) -> tuple[float, float]:
    """Return θ·φ and e·φ of one row (the latter but for a fold under way); `values` is empty where all are 1."""
    first = row * size
    if first < 0 or first + size > cells.shape[0] - 2 or not (values.size == 0 or values.size == indices.size):
        return math.nan, math.nan
    scale, shift, current = cells[-1, SCALE], cells[-1, SHIFT], cells[-1, CURRENT]
    theta = trace = 0.0
    for k in range(indices.size):
        i = indices[k]
        if i < 0 or i >= size:
            return math.nan, math.nan
        cell, phi = cells[first + i], values[k] if values.size else 1.0
        theta += (cell[U] + (shift if cell[MARK] == current else 0.0) * cell[TRACE]) * phi
        trace += scale * cell[TRACE] * phi
    return theta, trace


@kernel(f"float64({_FEATURES})")
def value(cells: Any, row: int, size: int, indices: Any, values: Any) -> Any:
    """Return θ·φ of one row."""
    return products(cells, row, size, indices, values)[0]


@kernel("float64[::1](float64[:,::1], int64, int64[::1], float64[::1])")
def all_values(cells: Any, size: int, indices: Any, values: Any) -> FloatArray:
    """Return θ·φ of every row."""
    found = np.empty((cells.shape[0] - 2) // size)
    for row in range(found.size):
        found[row] = value(cells, row, size, indices, values)
    return found


@kernel("void(float64[:,::1], int64)")
def fold(cells: Any, most: int) -> None:
    """Go on with a fold, if there is one, for at most so many cells."""
    once, state = cells[-1], cells[-2]
    if state[FOLDED] < 0.0:
        return
    count, first, kept = int(once[COUNT]), int(state[FOLDED]), int(state[KEPT])
    last = min(first + most, count)
    for k in range(first, last):
        i = int(cells[k, SUPPORT])
        cell = cells[i]
        cell[U] += once[SHIFT] * cell[TRACE]
        cell[TRACE] *= once[SCALE]
        state[LARGEST] = max(state[LARGEST], abs(cell[TRACE]))
        if abs(cell[TRACE]) > NEGLIGIBLE * state[LARGEST_BEFORE]:
            cell[MARK] = 3.0 - once[CURRENT]
            cells[kept, SUPPORT] = i
            kept += 1
        else:
            cell[TRACE] = cell[MARK] = 0.0
    state[FOLDED], state[KEPT] = last, kept
    if last < count:
        return
    once[SCALE], once[SHIFT], once[COUNT], once[CURRENT] = 1.0, 0.0, kept, 3.0 - once[CURRENT]
    state[FOLDED], state[KEPT], state[LARGEST], state[LARGEST_BEFORE] = -1.0, 0.0, 0.0, state[LARGEST]


@kernel("void(float64[:,::1], float64, float64)")
def move(cells: Any, step: float, decay: float) -> None:
    """Do θ ← θ + step·e, then e ← decay·e; begin a fold where the scale has become small."""
    cells[-1, SHIFT] += step * cells[-1, SCALE]
    cells[-1, SCALE] *= decay
    if cells[-1, SCALE] < SMALLEST_SCALE:
        cells[-2, FOLDED] = 0.0
        fold(cells, BLOCK)


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
        if cells[i, MARK] == 0.0:
            cells[i, MARK] = cells[-1, CURRENT]
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
    fold(cells, cells.shape[0])
    delta = target - value(cells, row, size, indices, values)
    if not abs(delta) < BOUND:
        return math.inf * delta
    if replacing:
        clear(cells, row, size, indices)
    add(cells, row, size, indices, values, 1.0 / cells[-1, SCALE], 0.0)
    move(cells, alpha * delta, decay)
    return delta


@kernel(f"UniTuple(float64, 2)({_FEATURES}, int64, int64[::1], float64[::1], " + ", ".join(["float64"] * 5) + ")")
def dutch(
    cells: Any, row: int, size: int, indices: Any, values: Any, next_row: int, next_indices: Any, next_values: Any,
    reward: float, gamma: float, estimate: float, alpha: float, decay: float,
) -> tuple[float, float]:  # fmt: skip
    """Do one step of true online TD(λ), whose trace holds α, then e ← decay·e; return δ and the next value.

    `estimate` is the value that the step before gave to this state, NaN before the first.
    """
    fold(cells, cells.shape[0])
    next_value = value(cells, next_row, size, next_indices, next_values)
    now, traced = products(cells, row, size, indices, values)
    before = now if math.isnan(estimate) else estimate
    delta = reward + gamma * next_value - before
    if not abs(delta) + abs(now) < BOUND:
        return math.nan, next_value
    to_trace = alpha * (1.0 - traced) / cells[-1, SCALE]
    add(cells, row, size, indices, values, to_trace, alpha * (before - now))
    move(cells, delta, decay)
    return delta, next_value


@kernel(
    "float64(float64[:,::1], int64, int64[:,::1], float64[::1], float64[::1], "
    "float64, float64, float64, float64, float64[::1])"
)
def follow(
    cells: Any, size: int, coded: Any, values: Any, rewards: Any,
    gamma: float, estimate: float, alpha: float, decay: float, predictions: Any,
) -> float:  # fmt: skip
    """Do `dutch` from each row of binary features to the next, writing what each predicted; return the estimate.

    Where learning diverges, the predictions from there on are NaN, and so is what is returned; `values` is empty.
    """
    predictions[:] = math.nan
    for k in range(rewards.size):
        predictions[k] = value(cells, 0, size, coded[k], values)
        delta, estimate = dutch(
            cells, 0, size, coded[k], values, 0, coded[k + 1], values, rewards[k], gamma, estimate, alpha, decay
        )
        if not math.isfinite(delta):
            return math.nan
    return estimate


@kernel("void(float64[:,::1], int64, int64[:,::1], float64[::1], float64[::1])")
def each_value(cells: Any, size: int, coded: Any, values: Any, found: Any) -> None:
    """Write θ·φ of each row of binary features; `values` is empty."""
    for k in range(found.size):
        found[k] = value(cells, 0, size, coded[k], values)
