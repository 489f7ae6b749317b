"""What a learner is, and the few lines of linear algebra that all share."""

from __future__ import annotations

from collections.abc import Generator
from typing import Protocol

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition


class Learner(Protocol):
    """Learns from transitions, in the order in which they happened.

    `needs_next_action` says that a transition is complete only with the action chosen after it (as for SARSA).
    """

    needs_next_action: bool

    def update(self, transition: Transition) -> float:
        """Learn one transition and return its temporal-difference error, delta."""


class SlicedLearner(Learner, Protocol):
    """A learner whose updates can be suspended."""

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices of at most about 100 µs with a yield between them; return delta.

        It is cut at fixed points of the work: where, and for how long, it is left changes no bit of the result.
        """


class ControlLearner(Learner, Protocol):
    """A learner of action values."""

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return the estimated return of every action, shape (actions,)."""


class PredictionLearner(Learner, Protocol):
    """A learner of the return under the behaviour."""

    def predict(self, features: FeatureVector) -> float:
        """Return the estimated return."""


def linear_value(weights: FloatArray, features: FeatureVector) -> float:
    """Return the inner product of `weights`, shape (size,), and `features`."""
    if features.values is None and features.indices.size == 1:
        return float(weights[features.indices[0]])
    if features.values is None:
        return float(weights[features.indices].sum())
    return float(weights[features.indices] @ features.values)


def linear_values(weights: FloatArray, features: FeatureVector) -> FloatArray:
    """Return the inner products of every row of `weights`, shape (actions, size), and `features`."""
    if features.values is None and features.indices.size == 1:
        return weights[:, features.indices[0]]
    columns = weights[:, features.indices]
    values: FloatArray = columns.sum(axis=1) if features.values is None else columns @ features.values
    return values


def add_features(trace: FloatArray, features: FeatureVector, replacing: bool) -> None:
    """Add `features` to `trace`, shape (size,), in place; a replacing trace is set to them instead."""
    values = 1.0 if features.values is None else features.values
    if replacing:
        trace[features.indices] = values
    else:
        trace[features.indices] += values


def check_steps(alpha: float, gamma: float, lambda_: float = 0.0) -> None:
    """Raise `SpecError` unless alpha is positive and gamma and lambda_ are from 0 to 1."""
    if not alpha > 0:
        raise SpecError(f"alpha is {alpha}: give a step size above 0.")
    for name, value in (("gamma", gamma), ("lambda_", lambda_)):
        if not 0.0 <= value <= 1.0:
            raise SpecError(f"{name} is {value}: give a number from 0 to 1.")
