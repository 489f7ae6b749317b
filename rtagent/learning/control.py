"""Control: SARSA(λ), Watkins's Q(λ) and Expected SARSA(λ) over linear features.

`alpha` is the step size of all active features together, unless not `divide_alpha`; `gamma` the discount each
step, or each second (`gamma_per`); `lambda_` the decay of the traces. In Python, `gamma` and `lambda_` may be
functions of the transition: their values in the state in which it ends. An update raises `SpecError`, learning
nothing, where its delta is not finite.
"""

from __future__ import annotations

import math
from collections.abc import Generator

import numpy as np

from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.learner import checked, taken
from rtagent.learning.steps import Fraction, GammaPer, Rates, Trace, step_size
from rtagent.learning.traces import make_traces
from rtagent.policy import Policy
from rtagent.saving import Saved


class Sarsa:
    """SARSA(λ) (thesis, Algorithms 2 and 3; Sutton and Barto, section 12.7)."""

    needs_next_action = True

    def __init__(
        self,
        *,
        size: int,
        actions: int,
        active: int = 1,
        alpha: float = 0.1,
        divide_alpha: bool = True,
        gamma: Fraction = 0.9,
        gamma_per: GammaPer = "step",
        lambda_: Fraction = 0.9,
        trace: Trace = "accumulating",
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._replacing = trace == "replacing"
        self._q = make_traces(actions, size, initial, active)

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S', A') and return delta."""
        t, q = transition, self._q
        gamma, decay = self._rates(t)
        target = t.reward + gamma * q.value(taken(t.next_action), t.next_features) if gamma else t.reward
        return checked(q.credit(taken(t.action), t.features, target, self.alpha, decay, self._replacing), t)

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices."""
        delta = self.update(transition)
        yield from self._q.folding()
        return delta

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._q.inherit(place, like)

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return self._q.save()

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        self._q.restore(saved)


class QLearning:
    """Watkins's Q(λ) (Watkins 1989; Sutton and Barto, section 12.10); with λ = 0, Q-learning (section 6.5).

    The trace is cut before an action that is not greedy by the values of the moment at which it is learned.
    """

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        actions: int,
        active: int = 1,
        alpha: float = 0.1,
        divide_alpha: bool = True,
        gamma: Fraction = 0.9,
        gamma_per: GammaPer = "step",
        lambda_: Fraction = 0.0,
        trace: Trace = "accumulating",
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._has_trace = callable(lambda_) or lambda_ > 0
        self._replacing = trace == "replacing"
        self._q = make_traces(actions, size, initial, active)

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S') towards the best action of S', and return delta."""
        t, q, action = transition, self._q, taken(transition.action)
        gamma, decay = self._rates(t)
        target = t.reward + gamma * float(q.values(t.next_features).max()) if gamma else t.reward
        checked(target, t)
        if self._has_trace and self._explores(t.features, action):
            q.reset()
        return checked(q.credit(action, t.features, target, self.alpha, decay, self._replacing), t)

    def _explores(self, features: FeatureVector, action: int) -> bool:
        values = self._q.values(features)
        if not 0 <= action < values.size:
            return False
        return bool(-math.inf < values[action] < values.max())

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices."""
        delta = self.update(transition)
        yield from self._q.folding()
        return delta

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._q.inherit(place, like)

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return self._q.save()

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        self._q.restore(saved)


class ExpectedSarsa:
    """Expected SARSA(λ): the expectation under the agent's policy (Sutton and Barto, section 6.6 where λ = 0)."""

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        actions: int,
        policy: Policy,
        active: int = 1,
        alpha: float = 0.1,
        divide_alpha: bool = True,
        gamma: Fraction = 0.9,
        gamma_per: GammaPer = "step",
        lambda_: Fraction = 0.0,
        trace: Trace = "accumulating",
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._replacing = trace == "replacing"
        self._policy = policy
        self._q = make_traces(actions, size, initial, active)

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S') towards the expectation over the actions of S', and return delta."""
        t, q = transition, self._q
        gamma, decay = self._rates(t)
        target = t.reward + gamma * self._expectation(t.next_features) if gamma else t.reward
        return checked(q.credit(taken(t.action), t.features, target, self.alpha, decay, self._replacing), t)

    def _expectation(self, features: FeatureVector) -> float:
        values = self.action_values(features)
        if not np.isfinite(values).all():
            return math.nan
        return float(self._policy.probabilities(values) @ values)

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices."""
        delta = self.update(transition)
        yield from self._q.folding()
        return delta

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._q.inherit(place, like)

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return self._q.save()

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        self._q.restore(saved)
