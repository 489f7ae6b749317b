"""Control: SARSA(λ), Q-learning and Expected SARSA over linear features."""

from __future__ import annotations

from typing import Literal

import numpy as np

from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.learner import add_features, check_steps, linear_value, linear_values
from rtagent.policy import Policy

Trace = Literal["accumulating", "replacing"]


class ActionWeights:
    """Weights of shape (actions, size), and the action values that they give."""

    def __init__(self, actions: int, size: int, initial: float) -> None:
        self.weights: FloatArray = np.full((actions, size), initial, dtype=np.float64)

    def values(self, features: FeatureVector) -> FloatArray:
        """Return the value of every action, shape (actions,)."""
        return linear_values(self.weights, features)

    def value(self, features: FeatureVector, action: int | None) -> float:
        """Return the value of one action."""
        return linear_value(self.weights[action], features)

    def back_up(self, transition: Transition, alpha: float, next_value: float) -> float:
        """Move the value of the transition's own action towards its reward and `next_value`; return delta."""
        t = transition
        delta = t.reward + next_value - self.value(t.features, t.action)
        values = 1.0 if t.features.values is None else t.features.values
        self.weights[t.action, t.features.indices] += alpha * delta * values
        return delta


class Sarsa:
    """SARSA(λ) (thesis, Algorithms 2 and 3; Sutton and Barto, section 12.7).

    `alpha` is the step size of each weight, `gamma` the discount a step, `lambda_` the decay of the traces.
    """

    needs_next_action = True

    def __init__(
        self,
        *,
        size: int,
        actions: int,
        alpha: float = 0.1,
        gamma: float = 0.9,
        lambda_: float = 0.9,
        trace: Trace = "accumulating",
        initial: float = 0.0,
    ) -> None:
        check_steps(alpha, gamma, lambda_)
        self.alpha, self.gamma, self.lambda_ = alpha, gamma, lambda_
        self._replacing = trace == "replacing"
        self._q = ActionWeights(actions, size, initial)
        self.trace: FloatArray = np.zeros((actions, size))

    @property
    def weights(self) -> FloatArray:
        """The weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S', A') and return delta."""
        q, t = self._q, transition
        delta = t.reward - q.value(t.features, t.action)
        if not t.terminated:
            delta += self.gamma * q.value(t.next_features, t.next_action)
        self.trace *= self.gamma * self.lambda_
        add_features(self.trace[t.action], t.features, self._replacing)
        q.weights += self.alpha * delta * self.trace
        if t.last:
            self.trace[:] = 0.0
        return delta


class QLearning:
    """One-step Q-learning (Watkins 1989; Sutton and Barto, section 6.5)."""

    needs_next_action = False

    def __init__(
        self, *, size: int, actions: int, alpha: float = 0.1, gamma: float = 0.9, initial: float = 0.0
    ) -> None:
        check_steps(alpha, gamma)
        self.alpha, self.gamma = alpha, gamma
        self._q = ActionWeights(actions, size, initial)

    @property
    def weights(self) -> FloatArray:
        """The weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S') towards the best action of S', and return delta."""
        best = 0.0 if transition.terminated else float(self.action_values(transition.next_features).max())
        return self._q.back_up(transition, self.alpha, self.gamma * best)


class ExpectedSarsa:
    """One-step Expected SARSA (Sutton and Barto, section 6.6): the expectation under the agent's policy."""

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        actions: int,
        policy: Policy,
        alpha: float = 0.1,
        gamma: float = 0.9,
        initial: float = 0.0,
    ) -> None:
        check_steps(alpha, gamma)
        self.alpha, self.gamma = alpha, gamma
        self._policy = policy
        self._q = ActionWeights(actions, size, initial)

    @property
    def weights(self) -> FloatArray:
        """The weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S') towards the expectation over the actions of S', and return delta."""
        expected = 0.0 if transition.terminated else self._expectation(transition.next_features)
        return self._q.back_up(transition, self.alpha, self.gamma * expected)

    def _expectation(self, features: FeatureVector) -> float:
        values = self.action_values(features)
        return float(self._policy.probabilities(values) @ values)
