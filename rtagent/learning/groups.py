"""A group of demons: their features, what they learn by, and how their predictions turn out."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from typing import Any

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.cumulants import Cumulants
from rtagent.learning.demons import Demon
from rtagent.learning.lazy_trace import shared_trace
from rtagent.learning.off_policy import GTD
from rtagent.learning.one_by_one import OneByOne
from rtagent.learning.prediction import TD
from rtagent.learning.returns import PredictionErrors, Rupee, Verifier
from rtagent.learning.shared_trace import (
    NOTHING,
    Precision,
    Step,
    TraceGroup,
    numbers_of,
    restored_features,
    same_features,
    save_features,
)
from rtagent.learning.steps import Discount, Rates, step_size
from rtagent.learning.swift import SwiftTD
from rtagent.saving import Saved

LEARNERS: dict[str, Any] = {"td": TD, "swift_td": SwiftTD, "gtd": GTD}


class DemonGroup:
    """Demons that have everything in common but what they predict.

    `below` are groups whose predictions are further features of this one, as fractions of their spans.
    `watched` are the demons whose predictions are compared with returns.
    """

    def __init__(
        self, demons: Sequence[Demon], cumulants: Cumulants, size: int, active: int, precision: Precision,
        below: Sequence[DemonGroup], watched: Sequence[int], rupee: bool,
    ) -> None:  # fmt: skip
        first = demons[0]
        self.set, self._names = first.set, [demons[place].name for place in watched]
        self._layer = _Layer(first, size, below)
        active += self._layer.extra if active else 0
        self._rates = Rates(first.continuation.gamma, first.continuation.per, first.method.lambda_)
        self._discount = Discount(first.continuation.gamma, first.continuation.per)
        self._normalised = first.normalised
        self.watched = np.array(watched, dtype=np.intp)
        self._verifier = Verifier(len(watched))
        self._predicted: FloatArray | None = None
        self._spans = np.array([demon.span for demon in demons]).T
        self.learned = _learner(first, cumulants, size + self._layer.extra, active, precision)
        alpha = step_size(first.method.alpha, first.method.divide_alpha, active)
        self._rupee = Rupee(size + self._layer.extra, len(watched), alpha) if rupee and watched else None

    def predict(self, features: FeatureVector) -> FloatArray:
        """Return the predictions, shape (demons,)."""
        predictions: FloatArray = self.learned.predict(self._layer(features))
        return predictions

    def predict_one(self, features: FeatureVector, place: int) -> float:
        """Return the prediction of one demon, by its place in the group."""
        return float(self.learned.predict_some(self._layer(features), place, place + 1)[0])

    def check_spans(self) -> None:
        """Raise `SpecError` unless its predictions can be features of others."""
        if not self._normalised:
            raise SpecError(f"the demons {self.set!r} are features of others: let them be normalised.")
        if not np.all(np.isfinite(self._spans)) or np.any(self._spans[0] >= self._spans[1]):
            raise SpecError(f"the demons {self.set!r} are features of others: their signals need finite ranges.")

    def fractions(self, predictions: FloatArray) -> FloatArray:
        """Return predictions as fractions of the spans of their cumulants, from 0 to 1."""
        low, high = self._spans
        fractions: FloatArray = np.clip((predictions - low) / (high - low), 0.0, 1.0)
        return fractions

    def begin(self, transition: Transition) -> None:
        """See to its features, before any group has learned from a transition."""
        self._layer.begin(transition)

    def updating(self, transition: Transition, signals: FloatArray) -> Generator[None, None, None]:
        """Learn a transition in slices; `signals` are what cumulants are taken of."""
        step = self._step(transition, signals)
        yield from self.learned.updating(step)
        if self._rupee is not None:
            self._add_rupee(self._rupee, step)
        if len(self.watched):
            yield from self._verify(step)

    def _step(self, t: Transition, signals: FloatArray) -> Step:
        gamma, decay = self._rates(t)
        scale = 1.0 - self._discount.of(t) if self._normalised else 1.0
        features, following = self._layer.step(t)
        return Step(features, following, signals, scale, gamma, decay, t.last, t)

    def _verify(self, step: Step) -> Generator[None, None, None]:
        if self._predicted is not None:
            cumulant = self.learned.cumulant[self.watched].astype(float)
            yield from self._verifier.add(self._predicted, cumulant, step.gamma, step.last)
        self._predicted = None if step.last else self.learned.estimate[self.watched].astype(float)

    def _add_rupee(self, rupee: Rupee, step: Step) -> None:
        delta = self.learned.delta[self.watched].astype(float)
        rupee.add(step.features.indices, numbers_of(step.features), delta, step.decay)

    def errors(self) -> Iterator[tuple[str, PredictionErrors]]:
        """Yield the errors of the watched demons, with their names."""
        rupees = self._rupee.values() if self._rupee is not None else None
        yield from zip(self._names, self._verifier.errors(rupees), strict=True)

    def save(self) -> Saved:
        """Return the state."""
        return {
            "learned": self.learned.save(),
            "layer": self._layer.save(),
            "verifier": self._verifier.save(),
            "rupee": self._rupee.save() if self._rupee else None,
            "predicted": None if self._predicted is None else self._predicted.copy(),
        }

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        self.learned.restore(saved["learned"])
        self._layer.restore(saved["layer"])
        self._verifier.restore(saved["verifier"])
        if self._rupee is not None:
            self._rupee.restore(saved["rupee"])
        self._predicted = None if saved["predicted"] is None else saved["predicted"].copy()


class _Layer:
    """The features of a group: those of the agent, and the predictions of the groups below it."""

    def __init__(self, demon: Demon, size: int, below: Sequence[DemonGroup]) -> None:
        missing = set(demon.on) - {group.set for group in below}
        if missing:
            raise SpecError(f"on names {sorted(missing)[0]!r}, and no set of demons is called that.")
        self._below, self._size = below, size
        self.extra: int = sum(len(group.learned.estimate) for group in below)
        for group in below:
            group.check_spans()
        self._own = np.arange(size, size + self.extra)
        self._base, self._newest = NOTHING, NOTHING

    def __call__(self, features: FeatureVector) -> FeatureVector:
        if not self._below:
            return features
        return self._joined(features, [group.predict(features) for group in self._below])

    def begin(self, t: Transition) -> None:
        """See to the features of a transition's beginning, before the groups below have learned from it."""
        if self._below and not same_features(self._base, t.features):
            self._newest = self(t.features)

    def step(self, t: Transition) -> tuple[FeatureVector, FeatureVector]:
        """Return the features of both ends of a transition, after the groups below have learned from it."""
        if not self._below:
            return t.features, t.next_features
        features = self._newest
        self._newest = self._joined(t.next_features, [group.learned.estimate for group in self._below])
        self._base = NOTHING if t.last else t.next_features
        return features, self._newest

    def _joined(self, features: FeatureVector, predictions: Sequence[Any]) -> FeatureVector:
        fractions = [group.fractions(each) for group, each in zip(self._below, predictions, strict=True)]
        indices = np.concatenate((features.indices, self._own))
        return FeatureVector(indices, np.concatenate((numbers_of(features), *fractions)))

    def save(self) -> Saved:
        return {"base": save_features(self._base), "newest": save_features(self._newest)}

    def restore(self, saved: Saved) -> None:
        self._base, self._newest = restored_features(saved["base"]), restored_features(saved["newest"])


def _learner(demon: Demon, cumulants: Cumulants, size: int, active: int, precision: Precision) -> TraceGroup:
    method, continuation = demon.method, demon.continuation
    if method.algorithm == "true_online_td":
        return shared_trace(size, cumulants, step_size(method.alpha, method.divide_alpha, active), precision)
    settings: dict[str, Any] = {
        "size": size,
        "active": active,
        "alpha": method.alpha,
        "divide_alpha": method.divide_alpha,
        "gamma": continuation.gamma,
        "gamma_per": continuation.per,
        "lambda_": method.lambda_,
    }
    if method.algorithm == "gtd":
        settings["target"] = demon.policy
    return OneByOne(cumulants, [LEARNERS[method.algorithm](**settings) for _ in range(len(cumulants))])
