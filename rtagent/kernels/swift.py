"""One step of SwiftTD over the features that have a trace: the sparse form of `rtagent.learning.swift`.

All is in one array, because each array more makes a call slower: cells of shape (size + 1, 12). A cell has what
SwiftTD keeps of one weight, how much is left of its traces since it was last active, whether it is in the support,
and a place for one number of the support's list, whose length is in the last cell.
"""

from __future__ import annotations

import math
from typing import Any

from rtagent.kernels.compiling import kernel

W, BETA, H, H_OLD, H_TEMP, Z, Z_DELTA, Z_BAR, P, LEFT, INSIDE, SUPPORT = range(12)
COLUMNS = 12
NEGLIGIBLE = 1e-12
"""A feature whose traces have decayed to this is forgotten."""

_FEATURES = "int64[::1], float64[::1]"


@kernel(f"float64(float64[:,::1], int64, {_FEATURES})")
def product(cells: Any, column: int, indices: Any, values: Any) -> Any:
    """Return the inner product of one column and the features; NaN for an index out of range."""
    if not (values.size == 0 or values.size == indices.size):
        return math.nan
    total = 0.0
    for k in range(indices.size):
        i = indices[k]
        if i < 0 or i >= cells.shape[0] - 1:
            return math.nan
        total += cells[i, column] * (values[k] if values.size else 1.0)
    return total


@kernel(f"float64(float64[:,::1], {_FEATURES})")
def rate_of_learning(cells: Any, indices: Any, values: Any) -> Any:
    """Return by which part of its error a step would move the value of these features."""
    total = 0.0
    for k in range(indices.size):
        phi = values[k] if values.size else 1.0
        total += math.exp(cells[indices[k], BETA]) * phi * phi
    return total


@kernel(f"void(float64[:,::1], {_FEATURES}, float64, float64, float64)")
def see(cells: Any, indices: Any, values: Any, rate: float, eta: float, log_epsilon: float) -> None:
    """Put the features into the traces, within the bound on the rate of learning."""
    traced = product(cells, Z, indices, values)
    bound = min(1.0, eta / rate) if rate > 0.0 else 1.0
    count = int(cells[-1, SUPPORT])
    for k in range(indices.size):
        cell, phi = cells[indices[k]], values[k] if values.size else 1.0
        z_delta = bound * math.exp(cell[BETA]) * phi
        if rate > eta:
            cell[H] = cell[H_OLD] = cell[Z_BAR] = 0.0
            cell[BETA] += log_epsilon * phi * phi
        cell[Z_DELTA] = z_delta
        cell[Z] += z_delta * (1.0 - traced)
        cell[P] += cell[H_OLD] * phi
        cell[Z_BAR] += z_delta * (1.0 - traced - cell[Z_BAR] * phi)
        cell[H_TEMP] = cell[H] - cell[H_OLD] * phi * (cell[Z] - z_delta) - cell[H] * z_delta * phi
        cell[LEFT] = 1.0
        if cell[INSIDE] == 0.0:
            cell[INSIDE] = 1.0
            cells[count, SUPPORT] = indices[k]
            count += 1
    cells[-1, SUPPORT] = count


@kernel("void(float64[:,::1], float64, float64, float64, float64, float64, float64)")
def move(
    cells: Any, delta: float, v_delta: float, decay: float, meta_step_size: float, least: float, most: float
) -> None:
    """Move weights and β (from `least` to `most`) of all that has a trace, and let the traces decay."""
    count, kept = int(cells[-1, SUPPORT]), 0
    for k in range(count):
        i = int(cells[k, SUPPORT])
        cell = cells[i]
        cell[W] += delta * cell[Z] - cell[Z_DELTA] * v_delta
        if meta_step_size > 0.0:
            beta = cell[BETA] + meta_step_size * math.exp(-cell[BETA]) * (delta - v_delta) * cell[P]
            cell[BETA] = min(max(beta, least), most)
        cell[H_OLD] = cell[H]
        cell[H] = cell[H_TEMP] + delta * cell[Z_BAR] - cell[Z_DELTA] * v_delta
        cell[H_TEMP] = cell[H]
        cell[Z_DELTA] = 0.0
        if cell[LEFT] == 0.0:  # forgotten in the step before: h_old has caught up with h now
            cell[INSIDE] = 0.0
            continue
        kept_part = decay if cell[LEFT] * decay >= NEGLIGIBLE else 0.0
        cell[LEFT] *= kept_part
        cell[Z] *= kept_part
        cell[P] *= kept_part
        cell[Z_BAR] *= kept_part
        cells[kept, SUPPORT] = i
        kept += 1
    cells[-1, SUPPORT] = kept


@kernel(
    f"UniTuple(float64, 2)(float64[:,::1], {_FEATURES}, {_FEATURES}, "
    "float64, float64, float64, float64, float64, float64, float64, float64, float64)"
)
def step(
    cells: Any, indices: Any, values: Any, next_indices: Any, next_values: Any,
    reward: float, gamma: float, decay: float, estimate: float,
    eta: float, meta_step_size: float, log_epsilon: float, least: float, most: float,
) -> tuple[float, float]:  # fmt: skip
    """Learn one transition; return δ and the value of its next features.

    Where one of both is not finite, nothing was learned.
    """
    value = product(cells, W, indices, values)
    next_value = product(cells, W, next_indices, next_values)
    before = value if math.isnan(estimate) else estimate
    delta = reward + gamma * next_value - before
    if not math.isfinite(delta + value + next_value):
        return math.nan, next_value
    rate = rate_of_learning(cells, indices, values)
    if not math.isfinite(rate):
        return math.nan, next_value
    see(cells, indices, values, rate, eta, log_epsilon)
    move(cells, delta, value - before, decay, meta_step_size, least, most)
    return delta, next_value


@kernel(
    "float64(float64[:,::1], int64[:,::1], float64[::1], float64[::1], "
    "float64, float64, float64, float64, float64, float64, float64, float64, float64[::1])"
)
def follow(
    cells: Any, coded: Any, values: Any, rewards: Any, gamma: float, decay: float, estimate: float,
    eta: float, meta_step_size: float, log_epsilon: float, least: float, most: float, predictions: Any,
) -> float:  # fmt: skip
    """Do `step` from each row of binary features to the next, writing what each predicted; return the estimate.

    Where learning diverges, the predictions from there on are NaN, and so is what is returned; `values` is empty.
    """
    predictions[:] = math.nan
    for k in range(rewards.size):
        predictions[k] = product(cells, W, coded[k], values)
        delta, estimate = step(
            cells, coded[k], values, coded[k + 1], values, rewards[k], gamma, decay, estimate,
            eta, meta_step_size, log_epsilon, least, most,
        )  # fmt: skip
        if not math.isfinite(delta):
            return math.nan
    return estimate
