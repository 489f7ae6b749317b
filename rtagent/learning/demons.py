"""Demons: general value functions (thesis, section 2.3.2), one by one or many from one declaration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from itertools import pairwise, product
from typing import ClassVar, Literal

import numpy as np

from rtagent.errors import SpecError
from rtagent.learning.cumulants import Cumulant, Signal, Within
from rtagent.learning.off_policy import Target
from rtagent.learning.steps import Fraction, GammaPer, checked_fraction
from rtagent.specs import Spec

Algorithm = Literal["true_online_td", "td", "swift_td", "gtd"]


@dataclass(frozen=True)
class Continuation:
    """Over which time a demon predicts: γ, each step or each second; in Python it may be a function."""

    gamma: Fraction = 0.9
    per: GammaPer = "step"

    def __post_init__(self) -> None:
        checked_fraction("gamma", self.gamma)

    def __str__(self) -> str:
        gamma = getattr(self.gamma, "__name__", None) or f"{self.gamma:g}"
        return gamma if self.per == "step" else f"{gamma}/s"


@dataclass(frozen=True)
class Method:
    """How a demon learns: the algorithm, its step size (of all active features together if divided) and λ."""

    algorithm: Algorithm = "true_online_td"
    alpha: float = 0.1
    divide_alpha: bool = True
    lambda_: Fraction = 0.9


@dataclass(frozen=True)
class Demon:
    """A general value function: the return of a cumulant, over a continuation, under a policy, and its learning.

    `policy` is the target policy that it asks about, as for `GTD` (None: as the agent behaves). `normalised`: it
    predicts (1 - γ) times the return, an average in the cumulant's own unit. `span` is the range of its
    cumulant; `on` names the sets of demons whose predictions are features for it, `set` its own.
    """

    name: str
    cumulant: Cumulant
    continuation: Continuation = field(default_factory=Continuation)
    policy: Target | None = None
    method: Method = field(default_factory=Method)
    normalised: bool = True
    span: tuple[float, float] = (0.0, 1.0)
    on: tuple[str, ...] = ()
    set: str = ""

    def __post_init__(self) -> None:
        if (self.policy is None) == (self.method.algorithm == "gtd"):
            raise SpecError(
                f"demon {self.name!r} has the policy {self.policy} and learns by {self.method.algorithm}: "
                "gtd, and nothing else, learns about a policy that is not the agent's own."
            )

    @property
    def shared(self) -> tuple[object, ...]:
        """What it has in common with demons that can share a trace with it."""
        return self.continuation, self.policy, self.method, self.normalised, self.on, self.set


@dataclass(frozen=True)
class Demons:
    """Many demons: for each signal that fits a pattern of `signals`, and each of `gammas`, one for its value.

    With `bins` also one for each of so many equal parts of its range: how much of the time it will be there.
    `policy` is the probability of each action under the policy that they ask about; they then learn by gtd.
    `name` is the set's, for others to build `on` it. What else is None is the Horde's.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    signals: tuple[str, ...] = ("*",)
    gammas: tuple[float, ...] = (0.9,)
    gamma_per: GammaPer = "step"
    bins: int = 0
    learner: Algorithm = "true_online_td"
    policy: tuple[float, ...] | None = None
    alpha: float | None = None
    divide_alpha: bool | None = None
    lambda_: float | None = None
    normalised: bool = True
    name: str = ""
    on: tuple[str, ...] = ()

    def expand(self, state: Mapping[str, Spec], usual: Method) -> Iterator[Demon]:
        """Yield the demons over the signals of `state`; raise `SpecError` where there are none, or no range.

        They learn by the `usual` method, but for what they say themselves.
        """
        chosen = _chosen(self.signals, state)
        if not self.gammas:
            raise SpecError("gammas is empty: give at least one, such as 0.9.")
        method = Method(
            self.learner,
            usual.alpha if self.alpha is None else self.alpha,
            usual.divide_alpha if self.divide_alpha is None else self.divide_alpha,
            usual.lambda_ if self.lambda_ is None else self.lambda_,
        )
        for gamma, signal in product(self.gammas, chosen):
            spec, continuation = state[signal], Continuation(gamma, self.gamma_per)
            place = list(state).index(signal)
            label = f"{self.name}: {signal}" if self.name else signal
            for part, cumulant, span in self._cumulants(signal, place, spec):
                name = f"{label}{part} γ={continuation}"
                yield Demon(
                    name, cumulant, continuation, self.policy, method, self.normalised, span, self.on, self.name
                )

    def _cumulants(
        self, signal: str, place: int, spec: Spec
    ) -> Iterator[tuple[str, Signal | Within, tuple[float, float]]]:
        yield "", Signal(place), (spec.low, spec.high)
        if not self.bins:
            return
        if not (math.isfinite(spec.low) and math.isfinite(spec.high)) or self.bins < 1:
            raise SpecError(f"signal {signal!r} cannot be cut into {self.bins} bins: it needs a finite range.")
        edges = np.linspace(spec.low, spec.high, self.bins + 1)
        edges[-1] = math.inf  # the upper end of the range belongs to the last part
        for number, (low, high) in enumerate(pairwise(edges.tolist())):
            yield f"[{number}]", Within(place, low, high), (0.0, 1.0)


def _chosen(patterns: Sequence[str], state: Mapping[str, Spec]) -> list[str]:
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in state):
            raise SpecError(f"no signal fits {pattern!r}: the state has {', '.join(state)}.")
    chosen = [name for name in state if any(fnmatchcase(name, pattern) for pattern in patterns)]
    for name in chosen:
        if state[name].shape:
            raise SpecError(f"signal {name!r} is an array of shape {state[name].shape}: demons predict numbers.")
    return chosen
