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


WIDE = 1e6


@dataclass(frozen=True)
class Spec:
    """One signal: its shape, dtype, unit and range (both ends belong to it).

    The range of a bool is 0 to 1. Raises `SpecError` where the range is empty, or a bool is given another one.
    """

    dtype: Literal["float", "int", "bool"] = "float"
    shape: tuple[int, ...] = ()
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        if self.dtype == "bool":
            if (self.low, self.high) not in ((-math.inf, math.inf), (0, 1)):
                raise SpecError("a bool is false or true: leave out its range.")
            object.__setattr__(self, "low", 0)
            object.__setattr__(self, "high", 1)
        if not self.low <= self.high or (self._ends() and self.dtype != "float" and self._whole_values() < 1):
            raise SpecError(f"the range of a spec is empty: low {self.low} is above high {self.high}.")

    @classmethod
    def discrete(cls, count: int) -> Spec:
        """Return the spec of one of `count` possibilities, 0 to count - 1."""
        return cls(dtype="int", low=0, high=count - 1)

    @classmethod
    def flag(cls) -> Spec:
        """Return the spec of something that is true or false."""
        return cls(dtype="bool")

    @property
    def count(self) -> int:
        """How many values a scalar of this spec can take; raises `SpecError` where that is not finite."""
        if self.dtype == "float" or self.shape or not self._ends():
            raise SpecError(f"{self} has no finite number of values: use a coder for continuous signals.")
        return self._whole_values()

    def problem(self, value: object) -> str | None:
        """Say in words what is wrong with `value`, or return None where it fits."""
        if self.shape == () and isinstance(value, float | int | bool | np.bool_ | np.floating | np.integer):
            return self._scalar_problem(value)
        try:
            array = np.asarray(value)
        except ValueError:
            return f"{value!r} is not an array of one shape"
        if array.dtype.kind not in "biuf":
            return f"{value!r} is not a number"
        if array.shape != self.shape:
            return f"its shape is {array.shape}, not {self.shape}"
        if self.dtype == "float" and bool((np.isfinite(array) & (array >= self.low) & (array <= self.high)).all()):
            return None  # at once, as a camera has thousands of values
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
        """Draw a value that fits, uniformly over the range, or over a wide part of one that has no end."""
        low = 0.0 + (self.low if math.isfinite(self.low) else min(self.high, WIDE) - 2 * WIDE)
        high = 0.0 + (self.high if math.isfinite(self.high) else low + 2 * WIDE)
        drawn: np.ndarray = np.asarray(
            rng.uniform(low, high, self.shape)
            if self.dtype == "float"
            else rng.integers(math.ceil(low), math.floor(high), self.shape, endpoint=True)
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

    def _ends(self) -> bool:
        return math.isfinite(self.low) and math.isfinite(self.high)

    def _whole_values(self) -> int:
        return math.floor(self.high) - math.ceil(self.low) + 1

    def _scalar_problem(self, value: float | np.floating | np.integer | np.bool_) -> str | None:
        if isinstance(value, float | np.floating) and not math.isfinite(value):
            return f"{value} is not finite"
        if self.dtype != "float" and int(value) != value:
            return f"{value} is not a whole number"
        if not self.low <= value <= self.high:
            return f"{value} is outside its range"
        return None


@dataclass(frozen=True)
class DeviceSpec:
    """What a device measures and what it can be told: a `Spec` by name for each signal.

    `rate` is how often it is sampled, in Hz: 0 for as of now, whenever it is read; `math.inf` for an event device,
    such as a button, which has a new sample only when something happens. A `synchronous` device changes only when
    acted upon: no time passes in it by itself.
    """

    sensors: Mapping[str, Spec] = field(default_factory=dict)
    actuators: Mapping[str, Spec] = field(default_factory=dict)
    rate: float = 0.0
    synchronous: bool = False
