"""Off-policy prediction: GTD(λ), which learns the return under one policy from what another one does."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.learner import checked, taken
from rtagent.learning.linear import check_count, check_range, product, values_of
from rtagent.learning.steps import Fraction, GammaPer, Rates, step_size
from rtagent.memory import claim
from rtagent.saving import Saved, restore_fields, save_fields

if TYPE_CHECKING:
    Target = Sequence[float] | Callable[[Transition], float]
    """The target policy: the probability of each action, or what says that of a transition's action."""
else:
    Target = tuple[float, ...]  # what a scenario can set: functions come from Python
STATE = ("theta", "h", "trace")


class GTD:
    """GTD(λ) (Maei 2011; Sutton and Barto, section 12.11): stable where off-policy TD(λ) may diverge.

    `target` is the target policy: the probability of each action in every state, or, in Python, a function of the
    transition that gives the probability of its action in the state in which it began. The behaviour's is the
    transition's own `probability`. `beta` is the step size of the second weights, h, which estimate the expected
    delta; `divide_alpha` divides it as well. The other settings are those of `TD`.
    """

    needs_next_action = False

    def __init__(
        self,
        *,
        size: int,
        target: Target,
        active: int = 1,
        alpha: float = 0.1,
        beta: float = 0.01,
        divide_alpha: bool = True,
        gamma: Fraction = 0.9,
        gamma_per: GammaPer = "step",
        lambda_: Fraction = 0.9,
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self.beta = step_size(beta, divide_alpha, active, "beta")
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._target = target if callable(target) else _distribution(target)
        check_count("size", size)
        claim(24 * size, "weights and their trace")
        self.theta: FloatArray = np.full(size, initial, dtype=np.float64)
        self.h, self.trace = np.zeros(size), np.zeros(size)

    @property
    def weights(self) -> FloatArray:
        """A copy of the weights, shape (size,)."""
        return self.theta.copy()

    def predict(self, features: FeatureVector) -> float:
        """Return the estimated return under the target policy from a state with these features."""
        return self._value(self.theta, features)

    def update(self, transition: Transition) -> float:
        """Learn (S, A, R, S') and return delta; raise `SpecError`, learning nothing, where it is not finite.

        Also raised where the behaviour's probability of A is not above 0, or there is no A.
        """
        t, rho = transition, self.importance(transition)
        gamma, decay = self._rates(t)
        lost = gamma * (1.0 - self._rates.lambda_(t))
        next_value = self._value(self.theta, t.next_features) if gamma else 0.0
        delta = checked(t.reward + gamma * next_value - self._value(self.theta, t.features), t)
        self.trace[t.features.indices] += values_of(t.features)
        self.trace *= rho
        self._correct(t, lost)
        self.theta += self.alpha * delta * self.trace
        self.h += self.beta * delta * self.trace
        self.trace *= decay
        return delta

    def importance(self, transition: Transition) -> float:
        """Return ρ: how much more probable its action is under the target policy than under the behaviour."""
        action, probability = taken(transition.action), transition.probability
        if not 0.0 < probability <= 1.0:
            raise SpecError(
                f"the behaviour took action {action} with probability {probability}: off-policy learning needs the "
                "probability of what was done, above 0 and at most 1."
            )
        return self._target_probability(transition, action) / probability

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        for weights in (self.theta, self.h):
            weights[place] = weights[like]
        self.trace[place] = 0.0

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return save_fields(self, STATE)

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        restore_fields(self, STATE, saved)

    def _correct(self, t: Transition, lost: float) -> None:
        """Do what takes the gradient beyond TD(λ), by the weights of before the step; `lost` is γ(1 - λ)."""
        expected = product(self.h, t.features)
        if lost:
            correction = self.alpha * lost * float(self.trace @ self.h)
            self.theta[t.next_features.indices] -= correction * values_of(t.next_features)
        self.h[t.features.indices] -= self.beta * expected * values_of(t.features)

    def _value(self, weights: FloatArray, features: FeatureVector) -> float:
        try:
            return product(weights, features)
        except (IndexError, ValueError):
            check_range(0, features, 1, weights.size)
            raise

    def _target_probability(self, transition: Transition, action: int) -> float:
        if callable(self._target):
            probability = float(self._target(transition))
        elif 0 <= action < len(self._target):
            probability = self._target[action]
        else:
            raise SpecError(f"target has no action {action}: give the probability of each action.")
        if not 0.0 <= probability <= 1.0:
            raise SpecError(f"target gave action {action} the probability {probability}: it must be from 0 to 1.")
        return probability


def _distribution(target: Sequence[float]) -> tuple[float, ...]:
    """Return the probabilities of a policy; raise `SpecError` where they are none."""
    given = tuple(float(probability) for probability in target)
    if not given or min(given) < 0.0 or not math.isclose(sum(given), 1.0, rel_tol=1e-6):
        raise SpecError(f"target is {given}: give the probability of each action, together 1.")
    return given
