"""Demons whose algorithm has step sizes or corrections of its own for each of them: one learner each."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experience import FeatureVector
from rtagent.learning.cumulants import Cumulants
from rtagent.learning.shared_trace import Step, Vector
from rtagent.saving import Saved


class OneByOne:
    """A group (`rtagent.learning.shared_trace.TraceGroup`) of learners that share nothing but their features."""

    def __init__(self, cumulants: Cumulants, learners: Sequence[Any]) -> None:
        self._cumulants, self._learners = cumulants, learners
        self.estimate, self.delta, self.cumulant = np.zeros((3, len(learners)), cumulants.precision)

    @property
    def weights(self) -> NDArray[Any]:
        """The weights, shape (size, demons)."""
        return np.stack([learner.weights for learner in self._learners], axis=1)

    def predict(self, features: FeatureVector) -> Vector:
        """Return the prediction of every demon."""
        return np.array([learner.predict(features) for learner in self._learners])

    def predict_some(self, features: FeatureVector, first: int, end: int) -> Vector:
        """Return the predictions of the demons from `first` up to `end`."""
        return np.array([learner.predict(features) for learner in self._learners[first:end]])

    def updating(self, step: Step) -> Generator[None, None, None]:
        """Learn a step, demon by demon."""
        self._cumulants.fill(step.signals, step.scale, self.cumulant)
        common = replace(step.transition, features=step.features, next_features=step.next_features)
        for place, learner in enumerate(self._learners):
            self.delta[place] = learner.update(replace(common, reward=float(self.cumulant[place])))
            self.estimate[place] = learner.predict(step.next_features)
            yield

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        for learner in self._learners:
            learner.inherit(place, like)

    def save(self) -> Saved:
        """Return the state of each learner."""
        return {str(place): learner.save() for place, learner in enumerate(self._learners)} | {
            "estimate": self.estimate.copy()
        }

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        for place, learner in enumerate(self._learners):
            learner.restore(saved[str(place)])
        self.estimate[:] = saved["estimate"]
