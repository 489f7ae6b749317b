"""Step sizes, discounts and the decay of traces, as scenarios state them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from rtagent.errors import SpecError
from rtagent.experience import Transition

GammaPer = Literal["step", "second"]
Trace = Literal["accumulating", "replacing"]
if TYPE_CHECKING:
    Fraction = float | Callable[[Transition], float]
    """From 0 to 1, or what says it of each transition: of the state in which that ends."""
else:
    Fraction = float  # what a scenario can set: functions come from Python


def step_size(alpha: float, divide_alpha: bool, active: int, name: str = "alpha") -> float:
    """Return the step size of each weight: `alpha`, divided by the number of active features if told so."""
    if not 0 < alpha < math.inf:
        raise SpecError(f"{name} is {alpha}: give a step size above 0.")
    if divide_alpha and active < 1:
        raise SpecError(f"active is {active}: give the number of active features, 1 or more.")
    return alpha / active if divide_alpha else alpha


class Discount:
    """The continuation γ at the end of a transition: `gamma` (0 to 1) for each step, or for each second of it."""

    def __init__(self, gamma: Fraction, per: GammaPer = "step") -> None:
        self.gamma, self._each_second = checked_fraction("gamma", gamma), per == "second"

    def __call__(self, transition: Transition) -> float:
        """Return γ; 0 where the episode terminated."""
        return 0.0 if transition.terminated else self.of(transition)

    def of(self, transition: Transition) -> float:
        """Return what γ would be, had the episode not terminated."""
        gamma = fraction_of("gamma", self.gamma, transition)
        return float(gamma ** (transition.elapsed / 1e9)) if self._each_second else gamma


class Rates:
    """What the state in which a transition ends says of returns and traces: γ, and γλ by which the trace decays.

    So the trace decays by the γλ of the state that it comes to next (van Seijen and others 2016; Sutton and Barto,
    section 12.8). `gamma` and `lambda_` are from 0 to 1.
    """

    def __init__(self, gamma: Fraction, gamma_per: GammaPer, lambda_: Fraction) -> None:
        self._discount, self._lambda = Discount(gamma, gamma_per), checked_fraction("lambda_", lambda_)
        self._fixed: tuple[float, float] | None = None
        if not callable(gamma) and not callable(lambda_) and gamma_per == "step":
            self._fixed = float(gamma), float(gamma * lambda_)

    def __call__(self, transition: Transition) -> tuple[float, float]:
        """Return γ (0 where the episode terminated) and γλ (0 where it is over, so that the trace is reset)."""
        if self._fixed is not None and not (transition.terminated or transition.truncated):
            return self._fixed
        gamma = self._discount(transition)
        return gamma, 0.0 if transition.last else gamma * self.lambda_(transition)

    @property
    def constant(self) -> tuple[float, float]:
        """γ and γλ of every step; raises `SpecError` where they depend on the transition."""
        if self._fixed is None:
            raise SpecError("gamma and lambda_ depend on the transition here: learn from transitions, one by one.")
        return self._fixed

    def lambda_(self, transition: Transition) -> float:
        """Return λ of the state in which a transition ends."""
        return fraction_of("lambda_", self._lambda, transition)


def fraction_of(name: str, value: Fraction, transition: Transition) -> float:
    """Return a fraction, asked for where it is a function; raise `SpecError` unless it is from 0 to 1."""
    if not callable(value):
        return value
    found = value(transition)
    check_fraction(name, found)
    return found


def checked_fraction(name: str, value: Fraction) -> Fraction:
    """Return `value`, or raise `SpecError` where it is a number that is not from 0 to 1."""
    if not callable(value):
        check_fraction(name, value)
    return value


def check_fraction(name: str, value: float) -> None:
    """Raise `SpecError` unless `value` is from 0 to 1."""
    if not 0.0 <= value <= 1.0:
        raise SpecError(f"{name} is {value}: give a number from 0 to 1.")
