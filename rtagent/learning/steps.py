"""Step sizes and discounts, as scenarios state them."""

from __future__ import annotations

import math
from typing import Literal

from rtagent.errors import SpecError
from rtagent.experience import Transition

GammaPer = Literal["step", "second"]


def step_size(alpha: float, divide_alpha: bool, active: int) -> float:
    """Return the step size of each weight: `alpha`, divided by the number of active features if told so."""
    if not 0 < alpha < math.inf:
        raise SpecError(f"alpha is {alpha}: give a step size above 0.")
    if divide_alpha and active < 1:
        raise SpecError("divide_alpha needs the number of active features: give active.")
    return alpha / active if divide_alpha else alpha


class Discount:
    """The continuation γ at the end of a transition: `gamma` (0 to 1) for each step, or for each second of it."""

    def __init__(self, gamma: float, per: GammaPer = "step") -> None:
        check_fraction("gamma", gamma)
        self.gamma, self._each_second = gamma, per == "second"

    def __call__(self, transition: Transition) -> float:
        """Return γ; 0 where the episode terminated."""
        if transition.terminated:
            return 0.0
        return float(self.gamma ** (transition.elapsed / 1e9)) if self._each_second else self.gamma


def check_fraction(name: str, value: float) -> None:
    """Raise `SpecError` unless `value` is from 0 to 1."""
    if not 0.0 <= value <= 1.0:
        raise SpecError(f"{name} is {value}: give a number from 0 to 1.")
