"""True online TD(λ) and true online SARSA(λ) (van Seijen and others 2016): the plain numpy form.

The trace holds the step size, as in Algorithm 1 of the thesis, read with its first estimate as the value of the
first state, and the value after termination as 0.
"""

from __future__ import annotations

import numpy as np

from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.learner import check_steps, linear_value, linear_values


class _DutchTrace:
    """Weights of shape (size,) with a dutch trace, and the estimate that the last step made of this state."""

    def __init__(self, weights: FloatArray, alpha: float, decay: float) -> None:
        self._weights, self._alpha, self._decay = weights, alpha, decay
        self.trace: FloatArray = np.zeros_like(weights)
        self._estimate: float | None = None

    def learn(self, t: Transition, row: int, next_row: int, gamma: float) -> float:
        """Learn one transition from `row` of the weights to `next_row`; return delta."""
        alpha, trace, weights = self._alpha, self.trace, self._weights
        indices = t.features.indices
        values = 1.0 if t.features.values is None else t.features.values
        value = linear_value(weights[row], t.features)
        estimate = value if self._estimate is None else self._estimate
        next_value = 0.0 if t.terminated else linear_value(weights[next_row], t.next_features)
        delta = t.reward + gamma * next_value - estimate
        trace *= self._decay
        trace[row, indices] += alpha * (1.0 - linear_value(trace[row], t.features)) * values
        weights += delta * trace
        weights[row, indices] += alpha * (estimate - value) * values
        self._estimate = next_value
        if t.last:
            trace[:] = 0.0
            self._estimate = None
        return delta


class TrueOnlineTD:
    """True online TD(λ) (thesis, Algorithm 1): equal to the online λ-return at every step.

    `alpha` is the step size of each weight: with c active features it must stay below about 1 / c.
    """

    needs_next_action = False

    def __init__(
        self, *, size: int, alpha: float = 0.1, gamma: float = 0.9, lambda_: float = 0.9, initial: float = 0.0
    ) -> None:
        check_steps(alpha, gamma, lambda_)
        self.gamma = gamma
        self._table: FloatArray = np.full((1, size), initial, dtype=np.float64)
        self._dutch = _DutchTrace(self._table, alpha, gamma * lambda_)

    @property
    def weights(self) -> FloatArray:
        """The weights, shape (size,)."""
        weights: FloatArray = self._table[0]
        return weights

    def predict(self, features: FeatureVector) -> float:
        """Return the estimated return from a state with these features."""
        return linear_value(self._table[0], features)

    def update(self, transition: Transition) -> float:
        """Learn (S, R, S') and return delta."""
        return self._dutch.learn(transition, 0, 0, self.gamma)


class TrueOnlineSarsa:
    """True online SARSA(λ) (Sutton and Barto, section 12.7)."""

    needs_next_action = True

    def __init__(
        self,
        *,
        size: int,
        actions: int,
        alpha: float = 0.1,
        gamma: float = 0.9,
        lambda_: float = 0.9,
        initial: float = 0.0,
    ) -> None:
        check_steps(alpha, gamma, lambda_)
        self.gamma = gamma
        self.weights: FloatArray = np.full((actions, size), initial, dtype=np.float64)
        self._dutch = _DutchTrace(self.weights, alpha, gamma * lambda_)

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return linear_values(self.weights, features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S', A') and return delta."""
        return self._dutch.learn(transition, transition.action or 0, transition.next_action or 0, self.gamma)
