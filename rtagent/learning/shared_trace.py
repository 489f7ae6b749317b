"""Many predictions that share one trace: true online TD(λ) (thesis, Algorithm 1) for each, in plain numpy.

Demons that share features, continuation, λ, step size and policy have the same trace, whatever they predict.
`rtagent.learning.lazy_trace` is the fast form.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.cumulants import Cumulants
from rtagent.saving import Saved, restore_fields, save_fields

Precision = Literal["float32", "float64"]
Vector = NDArray[Any]
"""One number for each demon, in the precision of the weights."""

SAVED = ("weights", "trace", "estimate", "_decay", "_fresh")
SLICE = 100_000
"""A slice touches about so many weights."""


NOTHING = FeatureVector(np.zeros(0, dtype=np.intp))


class Step(NamedTuple):
    """What every demon of a group learns from: γ at the end (0 where it terminated), and γλ of the next step.

    `signals` are what cumulants are taken of, `scale` what they are multiplied by.
    """

    features: FeatureVector
    next_features: FeatureVector
    signals: FloatArray
    scale: float
    gamma: float
    decay: float
    last: bool
    transition: Transition


class TraceGroup(Protocol):
    """Demons that share a trace. `estimate` holds the predictions for the newest state learned about."""

    estimate: Vector
    delta: Vector
    cumulant: Vector

    @property
    def weights(self) -> NDArray[Any]:
        """The weights, shape (size, demons)."""

    def predict(self, features: FeatureVector) -> Vector:
        """Return the prediction of every demon, each from all that it has learned by now."""

    def predict_some(self, features: FeatureVector, first: int, end: int) -> Vector:
        """Return the predictions of the demons from `first` up to `end`."""

    def updating(self, step: Step) -> Generator[None, None, None]:
        """Learn a step, with a yield between slices: each demon has then learned it, or not yet."""

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weights of feature `like`, and no trace."""

    def save(self) -> Saved:
        """Return the state."""

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""


@dataclass
class SharedTrace:
    """The plain form."""

    size: int
    cumulants: Cumulants
    alpha: float
    precision: Precision = "float32"

    def __post_init__(self) -> None:
        demons = len(self.cumulants)
        self.weights: NDArray[Any] = np.zeros((self.size, demons), self.precision)
        self.trace: FloatArray = np.zeros(self.size)
        self.estimate, self.delta, self.cumulant = np.zeros((3, demons), self.precision)
        self._here, self._decay, self._fresh = NOTHING, 0.0, True

    def predict(self, features: FeatureVector) -> Vector:
        """Return the predictions, shape (demons,)."""
        return _values(self.weights, features)

    def predict_some(self, features: FeatureVector, first: int, end: int) -> Vector:
        """Return the predictions of the demons from `first` up to `end`."""
        return _values(self.weights[:, first:end], features)

    def updating(self, step: Step) -> Generator[None, None, None]:
        """Learn a step, a few demons at a time."""
        refuse_unknown((step.features, step.next_features), self.size)
        indices, x = step.features.indices, numbers_of(step.features)
        if not same_features(step.features, self._here):  # what came before is not known: the trace is cut here
            self._decay, self._fresh = 0.0, True
        trace = self.trace * self._decay
        trace[indices] += self.alpha * (1.0 - trace[indices] @ x) * x
        self.cumulants.fill(step.signals, step.scale, self.cumulant)
        for some in _slices(len(self.cumulants), len(indices) + int(np.count_nonzero(trace))):
            self._learn(step, trace, some)
            yield
        self._here = step.next_features
        self.trace, self._decay, self._fresh = trace, step.decay, False
        if step.last:
            self.trace, self._fresh = np.zeros(self.size), True

    def _learn(self, step: Step, trace: FloatArray, some: slice) -> None:
        weights, estimate = self.weights[:, some], self.estimate[some]
        value = _values(weights, step.features)
        following = _values(weights, step.next_features)
        if self._fresh:
            estimate[:] = value
        delta = self.cumulant[some] + step.gamma * following - estimate
        eligible = np.flatnonzero(trace)
        weights[eligible] += np.outer(trace[eligible], delta)
        weights[step.features.indices] += np.outer(numbers_of(step.features), self.alpha * (estimate - value))
        self.delta[some] = delta
        estimate[:] = following

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self.weights[place] = self.weights[like]
        self.trace[place] = 0.0

    def save(self) -> Saved:
        """Return weights, trace and estimates."""
        return save_fields(self, SAVED) | save_features(self._here)

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        restore_fields(self, SAVED, saved)
        self._here = restored_features(saved)


def save_features(features: FeatureVector) -> Saved:
    """Return feature vectors as they are saved."""
    return {
        "indices": features.indices.copy(),
        "values": None if features.values is None else features.values.copy(),
    }


def restored_features(saved: Saved) -> FeatureVector:
    """Return the features that were saved."""
    return FeatureVector(saved["indices"].copy(), None if saved["values"] is None else saved["values"].copy())


def same_features(one: FeatureVector, other: FeatureVector) -> bool:
    """Say whether two feature vectors are equal."""
    if one is other:
        return True
    alike = np.array_equal(one.indices, other.indices)
    if one.values is None or other.values is None:
        return alike and one.values is other.values
    return alike and np.array_equal(one.values, other.values)


def refuse_unknown(vectors: Iterable[FeatureVector], size: int) -> None:
    """Raise `SpecError` for a feature that there are no weights for."""
    for indices, _ in vectors:
        if len(indices) and not (indices.min() >= 0 and indices.max() < size):
            outside = indices[(indices < 0) | (indices >= size)][0]
            raise SpecError(f"there is no feature {outside}: this learner was made with size {size}.")


def _values(weights: NDArray[Any], features: FeatureVector) -> Vector:
    rows = weights[features.indices]
    values: Vector = rows.sum(axis=0) if features.values is None else features.values.astype(rows.dtype) @ rows
    return values


def numbers_of(features: FeatureVector) -> FloatArray:
    """Return the values of features, all 1 where they have none."""
    return np.ones(len(features.indices)) if features.values is None else features.values


def _slices(demons: int, rows: int) -> Iterator[slice]:
    each = max(1, SLICE // max(1, rows))
    return (slice(first, first + each) for first in range(0, demons, each))
