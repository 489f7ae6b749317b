"""Weights and traces that touch only what is active: the compiled form."""

from __future__ import annotations

from collections.abc import Generator
from types import ModuleType

import numpy as np

from rtagent.experience import FeatureVector, FloatArray, IndexArray
from rtagent.learning.linear import ALL_ONES, Parts, as_arrays, check_range, parts_saved
from rtagent.memory import claim
from rtagent.saving import Saved


class LazyTraces:
    """The compiled form; `linear` are the kernels of `rtagent.kernels.linear`."""

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

    def each_value(self, coded: IndexArray) -> FloatArray:
        """Return the values of the first row for binary features, a row of indices each, shape (n,)."""
        found = np.empty(len(coded))
        self._kernels.each_value(self._cells, self.size, np.require(coded, np.int64, ["C", "W"]), ALL_ONES, found)
        return found

    def follow(
        self, coded: IndexArray, rewards: FloatArray, gamma: float, estimate: float, alpha: float, decay: float
    ) -> tuple[FloatArray, float]:
        """Do `dutch` from each row of binary features to the next; return values and estimate."""
        found, rows = np.empty(len(rewards)), np.require(coded, np.int64, ["C", "W"])
        following = np.require(rewards, np.float64, ["C", "W"])
        numbers = gamma, estimate, alpha, decay
        estimate = self._kernels.follow(self._cells, self.size, rows, ALL_ONES, following, *numbers, found)
        return found, estimate

    def reset(self) -> None:
        """Set the trace to 0."""
        self._fold()
        self._kernels.move(self._cells, 0.0, 0.0)

    def folding(self) -> Generator[None, None, None]:
        """Do what an update has left to do, in slices."""
        while self._cells[-2, self._kernels.FOLDED] >= 0.0:
            yield
            self._kernels.fold(self._cells, self._kernels.BLOCK)

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._fold()
        u, trace = self._column(self._kernels.U), self._column(self._kernels.TRACE)
        u[:, place] = u[:, like] + self._cells[-1, self._kernels.SHIFT] * trace[:, like]
        trace[:, place] = 0.0

    def save(self) -> Saved:
        """Return weights and trace, shape (rows, size), before scale and shift are written into them."""
        self._fold()
        k = self._kernels
        weights, trace = self._column(k.U).copy(), self._column(k.TRACE).copy()
        scale, shift = self._cells[-1, [k.SCALE, k.SHIFT]].tolist()
        return vars(Parts(weights, trace, scale, shift, float(self._cells[-2, k.LARGEST_BEFORE])))

    def restore(self, saved: Saved) -> None:
        """Take a saved state, of either form."""
        parts, k = parts_saved(saved, self._shape), self._kernels
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
