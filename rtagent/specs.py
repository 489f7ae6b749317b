"""Specs: what a signal or a command may be. They validate values and can generate them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from rtagent.errors import SpecError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.random import Generator

Value = float | int | bool | np.ndarray
"""One value of a signal or of a command: a plain number where the shape is (), else an array."""


@dataclass(frozen=True)
class Spec:
    """One signal: its shape, dtype, unit and range (both ends belong to it).

    Raises `SpecError` where the range is empty or a bool is given a shape or a range.
    """

    dtype: Literal["float", "int", "bool"] = "float"
    shape: tuple[int, ...] = ()
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise SpecError(f"the range of a spec is empty: low {self.low} is above high {self.high}.")

    @classmethod
    def discrete(cls, count: int) -> Spec:
        """Return the spec of one of `count` possibilities, 0 to count - 1."""
        return cls(dtype="int", low=0, high=count - 1)

    @classmethod
    def flag(cls) -> Spec:
        """Return the spec of something that is true or false."""
        return cls(dtype="bool", low=0, high=1)

    @property
    def count(self) -> int:
        """How many values a scalar of this spec can take; raises `SpecError` where that is not finite."""
        if self.dtype == "float" or self.shape or math.isinf(self.low) or math.isinf(self.high):
            raise SpecError(f"{self} has no finite number of values: use a coder for continuous signals.")
        return int(self.high) - int(self.low) + 1

    def problem(self, value: object) -> str | None:
        """Say in words what is wrong with `value`, or return None where it fits."""
        if self.shape == () and isinstance(value, float | int | bool | np.bool_ | np.floating | np.integer):
            return self._scalar_problem(float(value))
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            return f"{value!r} is not a number"
        if array.shape != self.shape:
            return f"its shape is {array.shape}, not {self.shape}"
        return next(
            (found for item in array.flat if (found := self._scalar_problem(item)) is not None),
            None,
        )

    def validate(self, value: object, name: str = "the value") -> None:
        """Raise `SpecError`, naming the signal, where `value` does not fit."""
        problem = self.problem(value)
        if problem is not None:
            raise SpecError(f"{name}: {problem}; expected {self}.")

    def generate(self, rng: Generator) -> Value:
        """Draw a value that fits, uniformly where the range is finite."""
        low, high = max(self.low, -1e6), min(self.high, 1e6)
        drawn: np.ndarray = np.asarray(
            rng.uniform(low, high, self.shape)
            if self.dtype == "float"
            else rng.integers(int(low), int(high), self.shape, endpoint=True)
        )
        value: Value = drawn.astype(self.dtype) if self.shape else drawn.astype(self.dtype).item()
        return value

    def clip(self, value: float) -> float:
        """Return the nearest scalar within the range."""
        return min(max(value, self.low), self.high)

    def __str__(self) -> str:
        if self.dtype == "bool":
            return "true or false"
        size = f"array of shape {self.shape} of " if self.shape else ""
        unit = f" {self.unit}" if self.unit else ""
        return f"{size}{self.dtype} from {self.low:g} to {self.high:g}{unit}"

    def _scalar_problem(self, value: float) -> str | None:
        if not math.isfinite(value):
            return f"{value} is not finite"
        if self.dtype != "float" and int(value) != value:
            return f"{value} is not a whole number"
        if not self.low <= value <= self.high:
            return f"{value} is outside its range"
        return None


@dataclass(frozen=True)
class DeviceSpec:
    """What a device measures and what it can be told: a `Spec` by name for each signal.

    `rate` is how often it is sampled, in Hz (0: as of now, whenever it is read). A `synchronous` device changes
    only when acted upon: no time passes in it by itself.
    """

    sensors: Mapping[str, Spec] = field(default_factory=dict)
    actuators: Mapping[str, Spec] = field(default_factory=dict)
    rate: float = 0.0
    synchronous: bool = False
