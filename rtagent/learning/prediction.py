"""Prediction: TD(λ) over linear features."""

from __future__ import annotations

from collections.abc import Generator

from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning.learner import checked
from rtagent.learning.steps import Fraction, GammaPer, Rates, Trace, step_size
from rtagent.learning.traces import make_traces
from rtagent.saving import Saved


class TD:
    """TD(λ) (Sutton and Barto, section 12.2): the return of the reward under the behaviour.

    `alpha` is the step size of all active features together, unless not `divide_alpha`; `gamma` the discount
    each step, or each second (`gamma_per`); `lambda_` the decay of the trace. In Python, `gamma` and `lambda_` may
    be functions of the transition: their values in the state in which it ends.
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
        trace: Trace = "accumulating",
        initial: float = 0.0,
    ) -> None:
        self.alpha = step_size(alpha, divide_alpha, active)
        self._rates = Rates(gamma, gamma_per, lambda_)
        self._replacing = trace == "replacing"
        self._theta = make_traces(1, size, initial, active)

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
        target = t.reward + gamma * theta.value(0, t.next_features) if gamma else t.reward
        return checked(theta.credit(0, t.features, target, self.alpha, decay, self._replacing), t)

    def updating(self, transition: Transition) -> Generator[None, None, float]:
        """Do what `update` does, in slices."""
        delta = self.update(transition)
        yield from self._theta.folding()
        return delta

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        self._theta.inherit(place, like)

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return self._theta.save()

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        self._theta.restore(saved)
