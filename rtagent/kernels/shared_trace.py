"""Kernels of many linear predictions that share one trace (`rtagent.learning.lazy_trace` says how they work).

`weights` has shape (size, demons); vectors over demons have shape (demons,) and the dtype of the weights. Each call
does the demons from `first` up to `end`: no demon's arithmetic depends on where the calls are cut.
Loops are single and over few arrays, so that the compiler can prove that these do not overlap.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rtagent.kernels.compiling import kernel

Array = Any
"""Arrays of compiled code: numba has no types."""

BLOCK = 4096
"""So many demons at a time stay in the nearest cache."""

LEFT, ENTERED, OVERLAP, SQUARES, TRACE_HERE, TRACE_THERE = range(6)
"""What `compare` finds."""

GAMMA, ALPHA, KAPPA, SCALE, SQUARE, COMMON, HERE, THERE, FRESH, DIRECT = range(10)
"""The parameters of a step, in an array of the dtype of the weights: as in `rtagent.learning.lazy_trace`."""


@kernel("boolean(int64[::1], int64)", "boolean(Array(int64, 1, 'C', readonly=True), int64)")
def known(features: Array, size: int) -> bool:
    """Say whether all features are among `size`."""
    unknown = 0
    for feature in features:
        unknown += feature < 0 or feature >= size
    return unknown == 0


@kernel(
    "boolean(int64[::1], float64[::1], int64[::1], float64[::1], float64[::1], float64[::1], float64[::1],"
    " int64[::1], int64[::1], float64[::1])"
)
def compare(
    here: Array, x: Array, there: Array, y: Array, trace: Array, marks: Array, others: Array,
    left: Array, entered: Array, found: Array,
) -> bool:  # fmt: skip
    """Compare two feature vectors, `here` with values `x` and `there` with values `y`.

    `found` becomes: how many features left and entered (listed in `left` and `entered`), the inner product of
    both vectors, that of `here` with itself, and those of either with `trace`. `marks` and `others`, shape (size,),
    are all 0 before and after. Returns False, having done nothing, where a feature is not among them.
    """
    if not (known(here, trace.size) and known(there, trace.size)):
        return False
    overlap, squares, trace_here, trace_there = 0.0, 0.0, 0.0, 0.0
    for place in range(here.size):
        marks[here[place]] = x[place]
        squares += x[place] * x[place]
        trace_here += x[place] * trace[here[place]]
    lefts, enters = 0, 0
    for place in range(there.size):
        feature = there[place]
        others[feature] = 1.0
        overlap += y[place] * marks[feature]
        trace_there += y[place] * trace[feature]
        if marks[feature] == 0.0:
            entered[enters] = feature
            enters += 1
    for place in range(here.size):
        feature = here[place]
        if others[feature] == 0.0:
            left[lefts] = feature
            lefts += 1
        marks[feature] = 0.0
    for place in range(there.size):
        others[there[place]] = 0.0
    found[LEFT], found[ENTERED], found[OVERLAP] = lefts, enters, overlap
    found[SQUARES], found[TRACE_HERE], found[TRACE_THERE] = squares, trace_here, trace_there
    return True


@kernel("int64(int64[::1], float64[::1], float64, float64[::1], int64[::1], boolean[::1], int64)")
def extend_trace(
    here: Array, x: Array, amount: float, trace: Array, support: Array, listed: Array, count: int
) -> int:
    """Add `amount` times a feature vector to `trace`; return how many features its `support` lists now.

    `listed` says of every feature whether it does.
    """
    for place in range(here.size):
        feature = here[place]
        if not listed[feature]:
            listed[feature] = True
            support[count] = feature
            count += 1
        trace[feature] += amount * x[place]
    return count


@kernel("int64(float64[::1], int64[::1], boolean[::1], int64, float64, float64)")
def shrink_trace(trace: Array, support: Array, listed: Array, count: int, scale: float, least: float) -> int:
    """Multiply `trace` by `scale` and forget what falls under `least`; return how many are left in `support`."""
    kept = 0
    for place in range(count):
        feature = support[place]
        trace[feature] *= scale
        if abs(trace[feature]) < least:
            trace[feature], listed[feature] = 0.0, False
        else:
            support[kept] = feature
            kept += 1
    return kept


@kernel("void({t}[::1], int32[::1], {t}[::1], {t}[::1], {t}[::1], {t}, {t}[::1], int64, int64)", each=True)
def cumulate(
    signals: Array, source: Array, raw: Array, low: Array, high: Array, scale: float, z: Array, first: int, end: int
) -> None:
    """Set the cumulants `z`: the signals themselves where `raw` is 1, else whether low <= signal < high."""
    zero = z.dtype.type(0)
    for start in range(first, end, BLOCK):
        stop = min(start + BLOCK, end)
        some, kinds, lows, highs = source[start:stop], raw[start:stop], low[start:stop], high[start:stop]
        values = z[start:stop]
        for j in range(values.size):
            values[j] = signals[some[j]]
        for j in range(values.size):
            signal = values[j]
            inside = scale if (lows[j] <= signal) & (signal < highs[j]) else zero
            values[j] = scale * kinds[j] * signal + inside


@kernel()
def _correct(total: Array, beta: Array, offset: Array, estimate: Array, p: Array, change: Array) -> None:
    """Set `change` to what is due to the weights of all active features: see `lazy_trace`."""
    alpha, kappa, square, here = p[ALPHA], p[KAPPA], p[SQUARE], p[HERE]
    if p[FRESH] != 0:
        for j in range(total.size):
            estimate[j] = total[j] + square * offset[j] + here * beta[j]
    for j in range(total.size):
        value = total[j] + square * offset[j] + here * beta[j]
        change[j] = alpha * (estimate[j] - value) - kappa * beta[j]


@kernel()
def _learn(following: Array, beta: Array, estimate: Array, z: Array, delta: Array, p: Array) -> None:
    """Learn from the estimates of the following state, and keep them."""
    gamma, scale = p[GAMMA], p[SCALE]
    for j in range(delta.size):
        error = z[j] + gamma * following[j] - estimate[j]
        delta[j] = error
        beta[j] += scale * error
    for j in range(delta.size):
        estimate[j] = following[j]


@kernel()
def _add_row(row: Array, factor: float, to: Array) -> None:
    for j in range(to.size):
        to[j] += factor * row[j]


STEP = (
    "void({t}[:, ::1], {t}[::1], {t}[::1], {t}[::1], {t}[::1], {t}[::1], {t}[::1], int64[::1], {t}[::1],"
    " int64[::1], {t}[::1], {t}[::1], int64, int64)"
)


@kernel(STEP, each=True)
def step_by_changes(
    weights: Array, total: Array, beta: Array, offset: Array, estimate: Array, z: Array, delta: Array,
    left: Array, x: Array, entered: Array, y: Array, p: Array, first: int, end: int,
) -> None:  # fmt: skip
    """Learn one step of binary features, touching only the weights of features that left or entered.

    `x` and `y` are not read: the signature is that of `step_by_rows`.
    """
    one = weights.dtype.type(1)
    room = np.empty((2, BLOCK), weights.dtype)
    common, there, direct, count = p[COMMON], p[THERE], p[DIRECT], weights.dtype.type(entered.size)
    for start in range(first, end, BLOCK):
        stop = min(start + BLOCK, end)
        totals, offsets, betas = total[start:stop], offset[start:stop], beta[start:stop]
        deltas = delta[start:stop]
        change, following = room[0, : totals.size], room[1, : totals.size]
        _correct(totals, betas, offsets, estimate[start:stop], p, change)
        for feature in entered:
            _add_row(weights[feature, start:stop], one, totals)
        for feature in left:
            _add_row(weights[feature, start:stop], -one, totals)
        for j in range(totals.size):
            following[j] = totals[j] + common * offsets[j] + there * betas[j]
        _learn(following, betas, estimate[start:stop], z[start:stop], deltas, p)
        for j in range(totals.size):
            new = offsets[j] + change[j] + direct * deltas[j]
            offsets[j] = new
            totals[j] -= count * new
        for feature in entered:
            _add_row(offsets, -one, weights[feature, start:stop])
        for feature in left:
            _add_row(offsets, one, weights[feature, start:stop])


@kernel(STEP, each=True)
def step_by_rows(
    weights: Array, total: Array, beta: Array, offset: Array, estimate: Array, z: Array, delta: Array,
    here: Array, x: Array, there: Array, y: Array, p: Array, first: int, end: int,
) -> None:  # fmt: skip
    """Learn one step of any features, touching the weights of all that were or become active."""
    room = np.empty((2, BLOCK), weights.dtype)
    common, trace_there, direct = p[COMMON], p[THERE], p[DIRECT]
    for start in range(first, end, BLOCK):
        stop = min(start + BLOCK, end)
        totals, offsets, betas = total[start:stop], offset[start:stop], beta[start:stop]
        deltas = delta[start:stop]
        change, following = room[0, : totals.size], room[1, : totals.size]
        _correct(totals, betas, offsets, estimate[start:stop], p, change)
        for j in range(totals.size):
            offsets[j] += change[j]
        for place in range(here.size):
            _add_row(offsets, x[place], weights[here[place], start:stop])
        offsets[:] = 0
        totals[:] = 0
        for place in range(there.size):
            _add_row(weights[there[place], start:stop], y[place], totals)
        for j in range(totals.size):
            following[j] = totals[j] - common * change[j] + trace_there * betas[j]
        _learn(following, betas, estimate[start:stop], z[start:stop], deltas, p)
        if direct != 0:
            for place in range(here.size):
                _add_row(deltas, direct * x[place], weights[here[place], start:stop])
            _add_row(deltas, direct * common, totals)


ROWS = "void({t}[:, ::1], {t}[::1], int64[::1], {t}[::1], int64, int64)"


@kernel(ROWS, each=True)
def add_to_rows(weights: Array, vector: Array, rows: Array, factors: Array, first: int, end: int) -> None:
    """Add `factors` times `vector` to `rows` of the weights."""
    for start in range(first, end, BLOCK):
        stop = min(start + BLOCK, end)
        for place in range(rows.size):
            _add_row(vector[start:stop], factors[place], weights[rows[place], start:stop])


@kernel(ROWS, each=True)
def sum_rows(weights: Array, total: Array, rows: Array, factors: Array, first: int, end: int) -> None:
    """Add the sum of `factors` times `rows` of the weights to `total`."""
    for start in range(first, end, BLOCK):
        stop = min(start + BLOCK, end)
        for place in range(rows.size):
            _add_row(weights[rows[place], start:stop], factors[place], total[start:stop])


@kernel("void({t}[:, ::1], {t}[::1], {t}[::1], int64[::1], {t}[::1], {t}, {t}, {t}[::1], int64, int64)", each=True)
def predict(
    weights: Array, beta: Array, offset: Array, features: Array, values: Array, common: float, trace: float,
    out: Array, first: int, end: int,
) -> None:  # fmt: skip
    """Set `out` to the predictions; `common` and `trace` are the inner products with what is implicit."""
    for start in range(first, end, BLOCK):
        stop = min(start + BLOCK, end)
        predictions = out[start:stop]
        predictions[:] = 0
        for place in range(features.size):
            _add_row(weights[features[place], start:stop], values[place], predictions)
        _add_row(offset[start:stop], common, predictions)
        _add_row(beta[start:stop], trace, predictions)
