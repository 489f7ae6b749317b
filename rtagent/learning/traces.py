"""Linear values and their eligibility trace: weights of shape (rows, size), of which one row is learned at a time.

A prediction has one row, control a row for each action. There are two forms that do the same: `DenseTraces` is the
readable one; `LazyTraces` touches only what is active, in `rtagent.kernels.linear`.

Each rule (`credit`, `dutch`) does one step towards a target, and then lets the trace decay by γλ of the state that
comes next; a decay of 0 resets it. What is not finite changes nothing: the δ that is returned is not finite then.
Kernels run without the GIL: ask and learn from one thread at a time.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from rtagent import kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray
from rtagent.memory import claim
from rtagent.saving import Saved, restore_fields

WORTH_COMPILING = 1000
"""From so many weights on, with more than one active feature, a quicker update is worth loading the compiler."""

ALL_ONES: FloatArray = np.empty(0)
"""How kernels are told that all values are 1."""
NOTHING = FeatureVector(np.empty(0, dtype=np.intp))
"""What is active after the end."""


class Traces(Protocol):
    """Weights and trace of shape (rows, size)."""

    size: int

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (rows, size)."""

    def value(self, row: int, features: FeatureVector) -> float:
        """Return the inner product of one row of the weights and the features."""

    def values(self, features: FeatureVector) -> FloatArray:
        """Return the inner products of every row, shape (rows,)."""

    def credit(
        self, row: int, features: FeatureVector, target: float, alpha: float, decay: float, replacing: bool = False
    ) -> float:
        """Add the features to the trace, or replace it there; move the weights by αδe; return δ."""

    def dutch(
        self, row: int, features: FeatureVector, next_row: int, following: FeatureVector,
        reward: float, gamma: float, estimate: float, alpha: float, decay: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Do one step of true online TD(λ) (thesis, Algorithm 1), whose trace holds α; return δ and the next value.

        `estimate` is the value that the step before gave to this state, NaN before the first.
        """

    def reset(self) -> None:
        """Set the trace to 0."""

    def folding(self) -> Generator[None, None, None]:
        """Do what an update has left to do, in slices; without it the next update does it.

        How much of it was done changes no bit of what is predicted or learned.
        """

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""

    def restore(self, saved: Saved) -> None:
        """Take a saved state, of either form."""


def check_count(name: str, number: int) -> None:
    """Raise `SpecError` unless there is at least one."""
    if number < 1:
        raise SpecError(f"{name} is {number}: give 1 or more.")


def worth_compiling(rows: int, size: int, active: int) -> bool:
    """Whether what is learned is large enough for kernels."""
    return active > 1 and rows * size >= WORTH_COMPILING


def make_traces(rows: int, size: int, initial: float, active: int) -> Traces:
    """Return the form that is quicker for so many weights and active features (0: unknown, so the dense one)."""
    check_count("size", size)
    check_count("actions", rows)
    linear = kernels.load("linear") if worth_compiling(rows, size, active) else None
    return DenseTraces(rows, size, initial) if linear is None else LazyTraces(rows, size, initial, linear)


class DenseTraces:
    """The plain form: two arrays. Where there is no trace to decay, it touches only what is active."""

    def __init__(self, rows: int, size: int, initial: float) -> None:
        claim(16 * rows * size, "weights and their trace")
        self.size = size
        self._weights: FloatArray = np.full((rows, size), initial, dtype=np.float64)
        self._trace: FloatArray = np.zeros((rows, size))
        self._empty = True

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (rows, size)."""
        return self._weights.copy()

    def value(self, row: int, features: FeatureVector) -> float:
        """Return the inner product of one row of the weights and the features."""
        try:
            return product(self._weights[row], features)
        except (IndexError, ValueError):
            check_range(row, features, *self._weights.shape)
            raise

    def values(self, features: FeatureVector) -> FloatArray:
        """Return the inner products of every row, shape (rows,)."""
        try:
            return products(self._weights, features)
        except (IndexError, ValueError):
            check_range(0, features, *self._weights.shape)
            raise

    def credit(
        self, row: int, features: FeatureVector, target: float, alpha: float, decay: float, replacing: bool = False
    ) -> float:
        """Add the features to the trace, or replace it there; move the weights by αδe; return δ."""
        delta = target - self.value(row, features)
        if not math.isfinite(delta):
            return delta
        kept = 0.0 if replacing else self._trace[row, features.indices]
        self._trace[row, features.indices] = kept + values_of(features)
        self._move(row, features, alpha * delta, decay)
        return delta

    def dutch(
        self, row: int, features: FeatureVector, next_row: int, following: FeatureVector,
        reward: float, gamma: float, estimate: float, alpha: float, decay: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Do one step of true online TD(λ) (thesis, Algorithm 1; e holds α); return δ and the next value."""
        value, next_value = self.value(row, features), self.value(next_row, following)
        before = value if math.isnan(estimate) else estimate
        delta = reward + gamma * next_value - before
        if not math.isfinite(delta + value):
            return math.nan, next_value
        traced, values = product(self._trace[row], features), values_of(features)
        self._trace[row, features.indices] += alpha * (1.0 - traced) * values
        self._weights[row, features.indices] += alpha * (before - value) * values
        self._move(row, features, delta, decay)
        return delta, next_value

    def reset(self) -> None:
        """Set the trace to 0."""
        if not self._empty:
            self._trace[:] = 0.0
        self._empty = True

    def folding(self) -> Generator[None, None, None]:
        """Do nothing: an update leaves nothing to do."""
        yield from ()

    def save(self) -> Saved:
        """Return weights and trace, shape (rows, size)."""
        return vars(_Parts(self._weights.copy(), self._trace.copy()))

    def restore(self, saved: Saved) -> None:
        """Take a saved state, of either form."""
        parts = _parts(saved, self._weights.shape)
        self._weights[:] = parts.weights + parts.shift * parts.trace
        self._trace[:] = parts.scale * parts.trace
        self._empty = not self._trace.any()

    def _move(self, row: int, features: FeatureVector, step: float, decay: float) -> None:
        """Move the weights by step·e, and let e decay: everywhere, unless only what is active has a trace."""
        touched: Any = (row, features.indices) if self._empty else ...
        self._weights[touched] += step * self._trace[touched]
        self._trace[touched] *= decay
        self._empty = decay == 0.0


class LazyTraces:
    """The compiled form; `linear` are its kernels."""

    def __init__(self, rows: int, size: int, initial: float, linear: ModuleType) -> None:
        claim(32 * rows * size, "weights and their trace")
        self.size, self._shape, self._kernels = size, (rows, size), linear
        self._value, self._credit, self._dutch = linear.value, linear.credit, linear.dutch
        self._cells: FloatArray = np.zeros((rows * size + 2, 4))
        self._cells[:-2, linear.U] = initial
        self._cells[-1, [linear.SCALE, linear.CURRENT]] = 1.0
        self._cells[-2, linear.FOLDED] = -1.0

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (rows, size)."""
        self._fold()
        u, trace = self._column(self._kernels.U), self._column(self._kernels.TRACE)
        weights: FloatArray = u + self._cells[-1, self._kernels.SHIFT] * trace
        return weights

    def value(self, row: int, features: FeatureVector) -> float:
        """Return the inner product of one row of the weights and the features."""
        indices, values = features
        values = ALL_ONES if values is None else values
        try:
            found: float = self._value(self._cells, row, self.size, indices, values)
        except TypeError:
            found = self._value(self._cells, row, self.size, *as_arrays(features))
        if found != found:
            self._check_range(row, features)
        return found

    def values(self, features: FeatureVector) -> FloatArray:
        """Return the inner products of every row, shape (rows,)."""
        indices, values = features
        values = ALL_ONES if values is None else values
        try:
            found: FloatArray = self._kernels.all_values(self._cells, self.size, indices, values)
        except TypeError:
            found = self._kernels.all_values(self._cells, self.size, *as_arrays(features))
        if found[0] != found[0]:
            self._check_range(0, features)
        return found

    def credit(
        self, row: int, features: FeatureVector, target: float, alpha: float, decay: float, replacing: bool = False
    ) -> float:
        """Add the features to the trace, or replace it there; move the weights by αδe; return δ."""
        indices, values = features
        values = ALL_ONES if values is None else values
        try:
            delta: float = self._credit(
                self._cells, row, self.size, indices, values, target, alpha, decay, replacing
            )
        except TypeError:
            known = as_arrays(features)
            delta = self._credit(self._cells, row, self.size, *known, float(target), alpha, decay, replacing)
        if delta != delta:
            self._check_range(row, features)
        return delta

    def dutch(
        self, row: int, features: FeatureVector, next_row: int, following: FeatureVector,
        reward: float, gamma: float, estimate: float, alpha: float, decay: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Do one step of true online TD(λ) (thesis, Algorithm 1; e holds α); return δ and the next value."""
        (i, phi), (j, psi) = features, following
        phi, psi = ALL_ONES if phi is None else phi, ALL_ONES if psi is None else psi
        cells, size, numbers = self._cells, self.size, (gamma, estimate, alpha, decay)
        try:
            found: tuple[float, float] = self._dutch(cells, row, size, i, phi, next_row, j, psi, reward, *numbers)
        except TypeError:
            known, then = as_arrays(features), as_arrays(following)
            found = self._dutch(cells, row, size, *known, next_row, *then, float(reward), *numbers)
        if found[0] != found[0]:
            self._check_range(row, features)
            self._check_range(next_row, following)
        return found

    def reset(self) -> None:
        """Set the trace to 0."""
        self._fold()
        self._kernels.move(self._cells, 0.0, 0.0)

    def folding(self) -> Generator[None, None, None]:
        """Do what an update has left to do, in slices."""
        while self._cells[-2, self._kernels.FOLDED] >= 0.0:
            yield
            self._kernels.fold(self._cells, self._kernels.BLOCK)

    def save(self) -> Saved:
        """Return weights and trace, shape (rows, size), before scale and shift are written into them."""
        self._fold()
        k = self._kernels
        return {
            "weights": self._column(k.U).copy(),
            "trace": self._column(k.TRACE).copy(),
            "scale": float(self._cells[-1, k.SCALE]),
            "shift": float(self._cells[-1, k.SHIFT]),
            "largest": float(self._cells[-2, k.LARGEST_BEFORE]),
        }

    def restore(self, saved: Saved) -> None:
        """Take a saved state, of either form."""
        parts, k = _parts(saved, self._shape), self._kernels
        self._column(k.U)[:], self._column(k.TRACE)[:] = parts.weights, parts.trace
        support = np.flatnonzero(parts.trace)
        self._cells[:-2, k.MARK] = 0.0
        self._cells[support, k.MARK] = 1.0
        self._cells[: support.size, k.SUPPORT] = support
        self._cells[-1] = parts.scale, parts.shift, support.size, 1.0
        self._cells[-2] = -1.0, 0.0, 0.0, parts.largest

    def _column(self, which: int) -> FloatArray:
        return self._cells[:-2, which].reshape(self._shape)

    def _fold(self) -> None:
        """Finish a fold that is under way."""
        self._kernels.fold(self._cells, len(self._cells))

    def _check_range(self, row: int, features: FeatureVector) -> None:
        """Say so if it was an index out of range that gave NaN."""
        check_range(row, features, *self._shape)


@dataclass
class _Parts:
    """What is saved: weights + shift · trace are the weights, scale · trace is the trace.

    `largest` was its largest entry when scale and shift were last written into both.
    """

    weights: FloatArray
    trace: FloatArray
    scale: float = 1.0
    shift: float = 0.0
    largest: float = 0.0


def _parts(saved: Saved, shape: tuple[int, int]) -> _Parts:
    parts = _Parts(np.empty(shape), np.empty(shape))
    restore_fields(parts, ("weights", "trace", "scale", "shift", "largest"), saved)
    return parts


def check_range(row: int, features: FeatureVector, rows: int, size: int) -> None:
    """Raise `SpecError` for an action or a feature that there are no weights for, or another number of values."""
    if features.values is not None and len(features.values) != len(features.indices):
        raise SpecError(f"there are {len(features.indices)} active features with {len(features.values)} values.")
    if not 0 <= row < rows:
        raise SpecError(f"there is no action {row}: this learner was made for {rows}.")
    for index in features.indices:
        if not 0 <= index < size:
            raise SpecError(f"there is no feature {index}: this learner was made with size {size}.")


def as_arrays(features: FeatureVector) -> tuple[IndexArray, FloatArray]:
    """Return indices and values as kernels take them, whatever type or layout they have."""
    values = ALL_ONES if features.values is None else np.require(features.values, np.float64, ["C", "W"])
    return np.require(features.indices, np.int64, ["C", "W"]), values


def values_of(features: FeatureVector) -> FloatArray | float:
    """Return the values of active features: 1 where they have none."""
    return 1.0 if features.values is None else features.values


def product(weights: FloatArray, features: FeatureVector) -> float:
    """Return the inner product of `weights`, shape (size,), and `features`."""
    if features.values is not None:
        with np.errstate(invalid="ignore"):  # the learner tells what is not finite
            return float(weights[features.indices] @ features.values)
    if features.indices.size == 1:
        return float(weights[features.indices[0]])
    return float(weights[features.indices].sum())


def products(weights: FloatArray, features: FeatureVector) -> FloatArray:
    """Return the inner products of every row of `weights`, shape (rows, size), and `features`."""
    if features.values is None and features.indices.size == 1:
        return weights[:, features.indices[0]].copy()
    columns = weights[:, features.indices]
    with np.errstate(invalid="ignore"):
        values: FloatArray = columns.sum(axis=1) if features.values is None else columns @ features.values
    return values
