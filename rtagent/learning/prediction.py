"""Prediction: TD(λ) over linear features."""

from __future__ import annotations

import numpy as np

from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.control import Trace
from rtagent.learning.learner import add_features, check_steps, linear_value


class TD:
    """TD(λ) (Sutton and Barto, section 12.2): the return of the reward under the behaviour.

    `alpha` is the step size of each weight, `gamma` the discount a step, `lambda_` the decay of the trace.
    """

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        alpha: float = 0.1,
        gamma: float = 0.9,
        lambda_: float = 0.9,
        trace: Trace = "accumulating",
        initial: float = 0.0,
    ) -> None:
        check_steps(alpha, gamma, lambda_)
        self.alpha, self.gamma, self.lambda_ = alpha, gamma, lambda_
        self._replacing = trace == "replacing"
        self.weights: FloatArray = np.full(size, initial, dtype=np.float64)
        self.trace: FloatArray = np.zeros(size)

    def predict(self, features: FeatureVector) -> float:
        """Return the estimated return from a state with these features."""
        return linear_value(self.weights, features)

    def update(self, transition: Transition) -> float:
        """Learn (S, R, S') and return delta."""
        t = transition
        delta = t.reward - self.predict(t.features)
        if not t.terminated:
            delta += self.gamma * self.predict(t.next_features)
        self.trace *= self.gamma * self.lambda_
        add_features(self.trace, t.features, self._replacing)
        self.weights += self.alpha * delta * self.trace
        if t.last:
            self.trace[:] = 0.0
        return delta
