"""What components cost under the virtual clock: a constant, or drawn from a distribution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.schedule import Component


@dataclass(frozen=True)
class Cost:
    """A time (ns): `low` always, or drawn anew each time from a distribution.

    `uniform` lies between low and high; `normal` has mean low and deviation high; `exponential` is low plus
    an exponential of mean high. Nothing is ever below 0.
    """

    low: int = 0
    high: int = 0
    distribution: Literal["constant", "uniform", "normal", "exponential"] = "constant"

    def __post_init__(self) -> None:
        if self.low < 0 or self.high < 0:
            raise SpecError("a cost is negative: give times of 0 or more.")
        if self.distribution == "uniform" and self.high < self.low:
            raise SpecError("a uniform cost has high below low.")

    def draw(self, rng: Generator) -> int:
        """Return one cost in ns."""
        if self.distribution == "constant":
            return self.low
        if self.distribution == "uniform":
            return int(rng.integers(self.low, self.high, endpoint=True))
        if self.distribution == "normal":
            return max(0, round(rng.normal(self.low, self.high)))
        return self.low + round(rng.exponential(self.high))


Costs = Mapping[Component, Cost]
