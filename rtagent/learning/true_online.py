"""True online TD(λ) and true online SARSA(λ) (van Seijen and others 2016).

The trace holds the step size, as in Algorithm 1 of the thesis, read with its first estimate as the value of the
first state, and the value after termination as 0.
"""

from __future__ import annotations

import math
from collections.abc import Generator

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray, Transition
from rtagent.learning.learner import DIVERGED, checked, parts_of, taken
from rtagent.learning.linear import NOTHING
from rtagent.learning.steps import Fraction, GammaPer, Rates, step_size
from rtagent.learning.traces import make_traces
from rtagent.saving import Saved


class TrueOnlineTD:
    """True online TD(λ) (thesis, Algorithm 1): equal to the online λ-return at every step.

    Settings as for `TD`; `alpha` must stay below about 1.
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
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._theta = make_traces(1, size, initial, active)
        self._estimate = math.nan

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (size,)."""
        weights: FloatArray = self._theta.weights[0]
        return weights

    def predict(self, features: FeatureVector) -> float:
        """Return the estimated return from a state with these features."""
        return self._theta.value(0, features)

    def update(self, transition: Transition) -> float:
        """Learn (S, R, S') and return delta; raise `SpecError`, learning nothing, where it is not finite."""
        t, theta = transition, self._theta
        gamma, decay = self._rates(t)
        following = NOTHING if t.terminated else t.next_features
        delta, next_value = theta.dutch(
            0, t.features, 0, following, t.reward, gamma, self._estimate, self.alpha, decay
        )
        checked(delta, t)
        self._estimate = math.nan if t.last else next_value
        return delta

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices."""
        delta = self.update(transition)
        yield from self._theta.folding()
        return delta

    def predict_each(self, coded: IndexArray) -> FloatArray:
        """Return what `predict` would for binary features, a row of indices each, shape (n, active)."""
        return self._theta.each_value(coded)

    def follow(self, coded: IndexArray, rewards: FloatArray) -> FloatArray:
        """Learn from a stream at once: from each row of binary features, shape (n + 1, active), to the next.

        Return what was predicted of each but the last before it was learned from, shape (n,): the same as `predict`
        and `update` in turn, to the last bit. Raises `SpecError` where learning diverges, with what it had learned.
        """
        gamma, decay = self._rates.constant
        predictions, estimate = self._theta.follow(coded, rewards, gamma, self._estimate, self.alpha, decay)
        if not math.isfinite(estimate):
            raise SpecError(DIVERGED)
        self._estimate = estimate
        return predictions

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._theta.inherit(place, like)

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return {"theta": self._theta.save(), "estimate": self._estimate}

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        theta, estimate = parts_of(saved, "theta", "estimate")
        self._theta.restore(theta)
        self._estimate = estimate


class TrueOnlineSarsa:
    """True online SARSA(λ) (Sutton and Barto, section 12.7). Settings as for `TrueOnlineTD`."""

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
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._q = make_traces(actions, size, initial, active)
        self._estimate = math.nan

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (actions, size)."""
        return self._q.weights

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return Q(S, ·), shape (actions,)."""
        return self._q.values(features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S', A') and return delta; raise `SpecError`, learning nothing, where it is not finite."""
        t, q = transition, self._q
        gamma, decay = self._rates(t)
        then, following = (0, NOTHING) if t.terminated else (taken(t.next_action), t.next_features)
        delta, next_value = q.dutch(
            taken(t.action), t.features, then, following, t.reward, gamma, self._estimate, self.alpha, decay
        )
        checked(delta, t)
        self._estimate = math.nan if t.last else next_value
        return delta

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
        return {"q": self._q.save(), "estimate": self._estimate}

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        q, estimate = parts_of(saved, "q", "estimate")
        self._q.restore(q)
        self._estimate = estimate
