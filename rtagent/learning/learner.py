"""What a learner is, and what all check of a transition."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.returns import PredictionErrors
from rtagent.saving import Saved

DIVERGED = "the weights have grown beyond all bounds (make alpha smaller, or divide it by the active features)"


class Learner(Protocol):
    """Learns from transitions, in the order in which they happened.

    `needs_next_action` says that a transition is complete only with the action chosen after it (as for SARSA).
    """

    needs_next_action: bool

    def update(self, transition: Transition) -> float:
        """Learn one transition and return its temporal-difference error, delta."""


@runtime_checkable
class SlicedLearner(Learner, Protocol):
    """A learner whose updates can be suspended."""

    def updating(self, transition: Transition) -> Generator[bool | None, None, float]:
        """Do what `update` does, in slices of at most about 50 µs with a yield between them; return delta.

        It is cut at fixed points of the work: where, and for how long, it is left changes no bit of the result.
        It yields True where the slice that follows leaves all action values alone: a thread may then go on with it
        while an action is chosen.
        """


@runtime_checkable
class Inheriting(Learner, Protocol):
    """A learner for coders whose features become others."""

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace.

        Never called in the middle of an update.
        """


class ControlLearner(Learner, Protocol):
    """A learner of action values."""

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return the estimated return of every action, shape (actions,)."""


class PredictionLearner(Learner, Protocol):
    """A learner of the return under the behaviour."""

    def predict(self, features: FeatureVector) -> float | FloatArray:
        """Return the estimated return; a Horde those of its demons, shape (demons,)."""


@runtime_checkable
class Verified(Protocol):
    """A learner that compares its predictions with the returns that followed."""

    def errors(self) -> Mapping[str, PredictionErrors]:
        """Return the errors of those predictions that are compared, by their names."""


def checked(delta: float, transition: Transition) -> float:
    """Return `delta`, or raise `SpecError` where it is not finite: then nothing was learned."""
    if math.isfinite(delta):
        return delta
    raise SpecError(f"{_what_is_wrong(transition)}, so nothing was learned from this transition.")


def taken(action: int | None) -> int:
    """Return an action; raise `SpecError` where there is none."""
    if action is None:
        raise SpecError("this learner needs the actions that were taken, and a transition has none.")
    return action


def parts_of(saved: Saved, *names: str) -> list[Any]:
    """Return these parts of a saved state; raise `SpecError` where one is missing."""
    missing = [name for name in names if name not in saved]
    if missing:
        raise SpecError(f"the saved state has no {missing[0]!r}: it is of another learner.")
    return [saved[name] for name in names]


def _what_is_wrong(transition: Transition) -> str:
    if not math.isfinite(transition.reward):
        return f"the reward is {transition.reward}"
    for name, features in (("features", transition.features), ("next features", transition.next_features)):
        wrong = [] if features.values is None else np.flatnonzero(~np.isfinite(features.values)).tolist()
        if wrong:
            index, value = features.indices[wrong[0]], features.values[wrong[0]]  # type: ignore[index]  # not None
            return f"feature {index} of the {name} is {value}"
    return DIVERGED
