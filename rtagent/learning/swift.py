"""SwiftTD (Javed, Sharifnassab and Sutton 2024): true online TD(λ) whose step sizes adapt.

Each weight has a step size of its own, e^β, that follows the gradient of the error (as IDBD does); the rate of
learning of one step is bounded; where the bound holds a step back, the step sizes concerned decay.
"""

from __future__ import annotations

import math
from itertools import pairwise
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np

from rtagent import kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray, Transition
from rtagent.learning.learner import DIVERGED, checked, parts_of
from rtagent.learning.linear import (
    ALL_ONES,
    NOTHING,
    as_arrays,
    check_count,
    check_range,
    product,
    values_of,
)
from rtagent.learning.steps import Fraction, GammaPer, Rates, step_size
from rtagent.learning.traces import worth_compiling
from rtagent.memory import claim
from rtagent.saving import Saved, restore_fields, save_fields

SMALLEST_STEP_SIZE = 1e-10
"""No step size falls below it: the step of β is divided by it."""
KEPT = ("w", "beta", "h", "h_old", "h_temp", "z", "z_delta", "z_bar", "p", "left")
"""What is kept of each weight, by the paper's names; and what is `left` of its traces since it was active."""


class Limits(NamedTuple):
    """How step sizes may change; see `SwiftTD`. The last two are the least and the most that β may be."""

    eta: float
    meta_step_size: float
    log_epsilon: float
    least: float
    most: float


class Swift(Protocol):
    """The weights of SwiftTD, with all of `KEPT` as arrays of shape (size,), and one step of it."""

    w: FloatArray
    beta: FloatArray

    def value(self, features: FeatureVector) -> float:
        """Return the inner product of the weights and the features."""

    def step(
        self, features: FeatureVector, following: FeatureVector, reward: float,
        gamma: float, decay: float, estimate: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Learn one transition; return δ and the value of the features that follow.

        `estimate` is the value that the step before gave to this state, NaN before the first. Where δ is not
        finite, nothing was learned.
        """

    def follow(
        self, coded: IndexArray, rewards: FloatArray, gamma: float, decay: float, estimate: float
    ) -> tuple[FloatArray, float]:
        """Do `step` from each row of binary features, shape (n + 1, active), to the next.

        Return the values of all but the last, shape (n,), each before its step, and the estimate: NaN, from where
        learning diverges.
        """

    def restored(self) -> None:
        """Follow what was written to the arrays."""


class SwiftTD:
    """SwiftTD: true online TD(λ) with step sizes that adapt, a bound on the rate of learning, and their decay.

    `alpha` is the initial step size of all active features together, unless not `divide_alpha`. `eta` bounds
    the rate of learning: by which part of its error a step may move a prediction; where it is reached, the step
    sizes of the active features are multiplied by `epsilon`. `meta_step_size` is the step size of their logarithms
    (0: they never change). `gamma`, `gamma_per`, `lambda_` and `initial` as for `TD`.
    """

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        active: int = 1,
        alpha: float = 0.1,
        divide_alpha: bool = True,
        gamma: Fraction = 0.9,
        gamma_per: GammaPer = "step",
        lambda_: Fraction = 0.9,
        eta: float = 0.1,
        meta_step_size: float = 0.001,
        epsilon: float = 0.999,
        initial: float = 0.0,
    ) -> None:
        first = min(step_size(alpha, divide_alpha, active), step_size(eta, False, 0, "eta"))
        check_count("size", size)
        limits = _limits(eta, meta_step_size, epsilon)
        self._rates = Rates(gamma, gamma_per, lambda_)
        compiled = kernels.load("swift") if worth_compiling(1, size, active) else None
        self._swift: Swift = DenseSwift(size, limits) if compiled is None else SparseSwift(size, limits, compiled)
        self._swift.w[:], self._swift.beta[:] = initial, math.log(first)
        self._estimate = math.nan

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (size,)."""
        return self._swift.w.copy()

    @property
    def step_sizes(self) -> FloatArray:
        """The step size of each weight, shape (size,)."""
        sizes: FloatArray = np.exp(self._swift.beta)
        return sizes

    def predict(self, features: FeatureVector) -> float:
        """Return the estimated return from a state with these features."""
        return self._swift.value(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, R, S') and return delta; raise `SpecError`, learning nothing, where it is not finite."""
        t = transition
        gamma, decay = self._rates(t)
        following = NOTHING if t.terminated else t.next_features
        delta, next_value = self._swift.step(t.features, following, t.reward, gamma, decay, self._estimate)
        checked(delta, t)
        self._estimate = math.nan if t.last else next_value
        return delta

    def predict_each(self, coded: IndexArray) -> FloatArray:
        """Return what `predict` would for binary features, a row of indices each, shape (n, active)."""
        found: FloatArray = self._swift.w[coded].sum(axis=1)
        return found

    def follow(self, coded: IndexArray, rewards: FloatArray) -> FloatArray:
        """Learn from a stream at once, as `TrueOnlineTD.follow` does."""
        gamma, decay = self._rates.constant
        predictions, estimate = self._swift.follow(coded, rewards, gamma, decay, self._estimate)
        if not math.isfinite(estimate):
            raise SpecError(DIVERGED)
        self._estimate = estimate
        return predictions

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        swift = self._swift
        for name in KEPT:
            kept: FloatArray = getattr(swift, name)
            kept[place] = kept[like] if name in ("w", "beta") else 0.0

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return save_fields(self._swift, KEPT) | {"estimate": self._estimate}

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        (estimate,) = parts_of(saved, "estimate")
        restore_fields(self._swift, KEPT, saved)
        self._swift.restored()
        self._estimate = estimate


class DenseSwift:
    """The plain form: an array for each of `KEPT`."""

    def __init__(self, size: int, limits: Limits) -> None:
        claim(len(KEPT) * 8 * size, "weights and their traces")
        self._limits = limits
        self.w, self.beta, self.h, self.h_old, self.h_temp = np.zeros((5, size))
        self.z, self.z_delta, self.z_bar, self.p, self.left = np.zeros((5, size))

    def value(self, features: FeatureVector) -> float:
        """Return the inner product of the weights and the features."""
        try:
            return product(self.w, features)
        except (IndexError, ValueError):
            check_range(0, features, 1, self.w.size)
            raise

    def step(
        self, features: FeatureVector, following: FeatureVector, reward: float,
        gamma: float, decay: float, estimate: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Learn one transition; return δ and the value of the features that follow."""
        value, next_value = self.value(features), self.value(following)
        before = value if math.isnan(estimate) else estimate
        delta, rate = reward + gamma * next_value - before, self._rate_of_learning(features)
        if not math.isfinite(delta + value + next_value + rate):
            return math.nan, next_value
        self._see(features, rate)
        self._move(delta, value - before)
        self._fade(decay)
        return delta, next_value

    def follow(
        self, coded: IndexArray, rewards: FloatArray, gamma: float, decay: float, estimate: float
    ) -> tuple[FloatArray, float]:
        """Do `step` from each row of binary features to the next; return values and estimate."""
        values = np.full(len(rewards), math.nan)
        vectors = [FeatureVector(indices) for indices in coded]
        for number, ((features, following), reward) in enumerate(zip(pairwise(vectors), rewards, strict=True)):
            values[number] = self.value(features)
            delta, estimate = self.step(features, following, float(reward), gamma, decay, estimate)
            if not math.isfinite(delta):
                return values, math.nan
        return values, estimate

    def restored(self) -> None:
        """Do nothing: the arrays are all there is."""

    def _rate_of_learning(self, features: FeatureVector) -> float:
        """Return by which part of its error a step would move the value of these features."""
        phi = values_of(features)
        return float((np.exp(self.beta[features.indices]) * phi * phi).sum())

    def _see(self, features: FeatureVector, rate: float) -> None:
        """Put the features into the traces, within the bound on the rate of learning."""
        i, phi, eta = features.indices, values_of(features), self._limits.eta
        traced = product(self.z, features)
        self.z_delta[i] = z_delta = min(1.0, eta / rate if rate else 1.0) * np.exp(self.beta[i]) * phi
        if rate > eta:
            self.h[i] = self.h_old[i] = self.z_bar[i] = 0.0
            self.beta[i] += self._limits.log_epsilon * phi * phi
        self.z[i] += z_delta * (1.0 - traced)
        self.p[i] += self.h_old[i] * phi
        self.z_bar[i] += z_delta * (1.0 - traced - self.z_bar[i] * phi)
        self.h_temp[i] = self.h[i] - self.h_old[i] * phi * (self.z[i] - z_delta) - self.h[i] * z_delta * phi
        self.left[i] = 1.0

    def _move(self, delta: float, v_delta: float) -> None:
        """Move weights, step sizes, and h, which says how the weights depend on the step sizes."""
        limits, correction = self._limits, self.z_delta * v_delta
        self.w += delta * self.z - correction
        if limits.meta_step_size > 0.0:
            self.beta += limits.meta_step_size * np.exp(-self.beta) * (delta - v_delta) * self.p
            np.clip(self.beta, limits.least, limits.most, out=self.beta)
        self.h_old[:] = self.h
        self.h[:] = self.h_temp + delta * self.z_bar - correction
        self.h_temp[:] = self.h
        self.z_delta[:] = 0.0

    def _fade(self, decay: float) -> None:
        for trace in (self.z, self.p, self.z_bar, self.left):
            trace *= decay


class SparseSwift:
    """The compiled form, which visits only what has a trace; `kernels` are those of `rtagent.kernels.swift`."""

    def __init__(self, size: int, limits: Limits, kernels: ModuleType) -> None:
        claim(kernels.COLUMNS * 8 * size, "weights and their traces")
        self._limits, self._kernels, self._size = limits, kernels, size
        self._step = kernels.step
        self._cells: FloatArray = np.zeros((size + 1, kernels.COLUMNS))
        self.w, self.beta, self.h, self.h_old, self.h_temp, *rest = self._cells[:-1].T
        self.z, self.z_delta, self.z_bar, self.p, self.left, self._inside, self._support = rest

    def value(self, features: FeatureVector) -> float:
        """Return the inner product of the weights and the features."""
        indices, values = features
        values = ALL_ONES if values is None else values
        try:
            found: float = self._kernels.product(self._cells, self._kernels.W, indices, values)
        except TypeError:
            found = self._kernels.product(self._cells, self._kernels.W, *as_arrays(features))
        if found != found:
            check_range(0, features, 1, self._size)
        return found

    def step(
        self, features: FeatureVector, following: FeatureVector, reward: float,
        gamma: float, decay: float, estimate: float,
    ) -> tuple[float, float]:  # fmt: skip
        """Learn one transition; return δ and the value of the features that follow."""
        (i, phi), (j, psi) = features, following
        arrays = i, ALL_ONES if phi is None else phi, j, ALL_ONES if psi is None else psi
        numbers = reward, gamma, decay, estimate, *self._limits
        try:
            delta, next_value = self._step(self._cells, *arrays, *numbers)
        except TypeError:
            arrays = *as_arrays(features), *as_arrays(following)
            delta, next_value = self._step(self._cells, *arrays, float(reward), *numbers[1:])
        if delta != delta:
            check_range(0, features, 1, self._size)
            check_range(0, following, 1, self._size)
        return delta, next_value

    def follow(
        self, coded: IndexArray, rewards: FloatArray, gamma: float, decay: float, estimate: float
    ) -> tuple[FloatArray, float]:
        """Do `step` from each row of binary features to the next; return values and estimate."""
        found, rows = np.empty(len(rewards)), np.require(coded, np.int64, ["C", "W"])
        following = np.require(rewards, np.float64, ["C", "W"])
        numbers = gamma, decay, estimate, *self._limits
        return found, self._kernels.follow(self._cells, rows, ALL_ONES, following, *numbers, found)

    def restored(self) -> None:
        """Find the support: what has a trace, and what had one until the last step."""
        support = np.flatnonzero((self.left > 0.0) | (self.h_old != self.h))
        self._inside[:] = 0.0
        self._inside[support] = 1.0
        self._support[: support.size] = support
        self._cells[-1, self._kernels.SUPPORT] = support.size


def _limits(eta: float, meta_step_size: float, epsilon: float) -> Limits:
    if not 0.0 <= meta_step_size < math.inf:
        raise SpecError(f"meta_step_size is {meta_step_size}: give a number from 0 on.")
    if not 0.0 < epsilon <= 1.0:
        raise SpecError(f"epsilon is {epsilon}: give a number above 0, and at most 1.")
    least = min(SMALLEST_STEP_SIZE, eta)
    return Limits(eta, meta_step_size, math.log(epsilon), math.log(least), math.log(eta))
