"""Linear values and their eligibility trace: weights of shape (rows, size), of which one row is learned at a time.

A prediction has one row, control a row for each action. There are two forms that do the same: `DenseTraces` is the
readable one; `LazyTraces` touches only what is active.

Each rule (`credit`, `dutch`) does one step towards a target, and then lets the trace decay by γλ of the state that
comes next; a decay of 0 resets it. What is not finite, or grown beyond all bounds, changes nothing: the δ that is
returned is not finite then, and the weights are.
Kernels run without the GIL: ask and learn from one thread at a time.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from rtagent import kernels
from rtagent.experience import FeatureVector, FloatArray, IndexArray
from rtagent.learning.lazy import LazyTraces
from rtagent.learning.linear import (
    BOUND,
    Parts,
    check_count,
    check_range,
    parts_saved,
    product,
    products,
    values_of,
)
from rtagent.memory import claim
from rtagent.saving import Saved

WORTH_COMPILING = 1000
"""From so many weights on, with more than one active feature, a quicker update is worth loading the compiler."""
LARGE_TABLE = 20_000
"""And from so many on with one: where a trace decays, the dense form goes through all of them at every step."""


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

    def each_value(self, coded: IndexArray) -> FloatArray:
        """Return the values of the first row for binary features, a row of indices each, shape (n,)."""

    def follow(
        self, coded: IndexArray, rewards: FloatArray, gamma: float, estimate: float, alpha: float, decay: float
    ) -> tuple[FloatArray, float]:
        """Do `dutch` from each row of binary features, shape (n + 1, active), to the next.

        Return the values of all but the last, shape (n,), each before its step, and the estimate: NaN, from where
        learning diverges.
        """

    def reset(self) -> None:
        """Set the trace to 0."""

    def folding(self) -> Generator[None, None, None]:
        """Do what an update has left to do, in slices; without it the next update does it.

        How much of it was done changes no bit of what is predicted or learned.
        """

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weights of feature `like`, and no trace."""

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""

    def restore(self, saved: Saved) -> None:
        """Take a saved state, of either form."""


def worth_compiling(rows: int, size: int, active: int) -> bool:
    """Whether what is learned is large enough for kernels."""
    return active > 0 and rows * size >= (WORTH_COMPILING if active > 1 else LARGE_TABLE)


def make_traces(rows: int, size: int, initial: float, active: int) -> Traces:
    """Return the form that is quicker for so many weights and active features (of a table: 1)."""
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
        if not abs(delta) < BOUND:
            return math.inf * delta
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
        if not abs(delta) + abs(value) < BOUND:
            return math.nan, next_value
        traced, values = product(self._trace[row], features), values_of(features)
        self._trace[row, features.indices] += alpha * (1.0 - traced) * values
        self._weights[row, features.indices] += alpha * (before - value) * values
        self._move(row, features, delta, decay)
        return delta, next_value

    def each_value(self, coded: IndexArray) -> FloatArray:
        """Return the values of the first row for binary features, a row of indices each, shape (n,)."""
        return np.array([self.value(0, FeatureVector(indices)) for indices in coded], dtype=float)

    def follow(
        self, coded: IndexArray, rewards: FloatArray, gamma: float, estimate: float, alpha: float, decay: float
    ) -> tuple[FloatArray, float]:
        """Do `dutch` from each row of binary features to the next; return values and estimate."""
        values = np.full(len(rewards), math.nan)
        vectors = [FeatureVector(indices) for indices in coded]
        for step, ((features, following), reward) in enumerate(zip(pairwise(vectors), rewards, strict=True)):
            values[step] = self.value(0, features)
            delta, estimate = self.dutch(0, features, 0, following, float(reward), gamma, estimate, alpha, decay)
            if not math.isfinite(delta):
                return values, math.nan
        return values, estimate

    def reset(self) -> None:
        """Set the trace to 0."""
        if not self._empty:
            self._trace[:] = 0.0
        self._empty = True

    def folding(self) -> Generator[None, None, None]:
        """Do nothing: an update leaves nothing to do."""
        yield from ()

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._weights[:, place] = self._weights[:, like]
        self._trace[:, place] = 0.0

    def save(self) -> Saved:
        """Return weights and trace, shape (rows, size)."""
        return vars(Parts(self._weights.copy(), self._trace.copy()))

    def restore(self, saved: Saved) -> None:
        """Take a saved state, of either form."""
        parts = parts_saved(saved, self._weights.shape)
        self._weights[:] = parts.weights + parts.shift * parts.trace
        self._trace[:] = parts.scale * parts.trace
        self._empty = not self._trace.any()

    def _move(self, row: int, features: FeatureVector, step: float, decay: float) -> None:
        """Move the weights by step·e, and let e decay: everywhere, unless only what is active has a trace."""
        touched: Any = (row, features.indices) if self._empty else ...
        self._weights[touched] += step * self._trace[touched]
        self._trace[touched] *= decay
        self._empty = decay == 0.0
