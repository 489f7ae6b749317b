"""Cumulants: what demons predict the return of, as one table for many demons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent import kernels
from rtagent.experience import FloatArray, Transition


@dataclass(frozen=True, slots=True)
class Signal:
    """The value of a signal of the next state, by its place in the state."""

    place: int


@dataclass(frozen=True, slots=True)
class Within:
    """1 where a signal of the next state is within low <= signal < high, else 0."""

    place: int
    low: float
    high: float


Cumulant = Signal | Within | Callable[[Transition], float]
"""What a demon predicts: a signal, whether it is within a range, or any function of a transition."""


class Cumulants:
    """The cumulants of the demons of a group; those that are functions come after the signals in `signals`."""

    def __init__(self, cumulants: Sequence[Signal | Within], precision: str) -> None:
        withins = [each for each in cumulants if isinstance(each, Within)]
        self.precision = precision
        self.source = np.array([each.place for each in cumulants], dtype=np.int32)
        self.raw = np.array([isinstance(each, Signal) for each in cumulants], dtype=precision)
        self.low, self.high = np.zeros((2, len(cumulants)), dtype=precision)
        self.low[self.raw == 0] = [each.low for each in withins]
        self.high[self.raw == 0] = [each.high for each in withins]
        self.high[self.raw == 1] = -np.inf  # what is taken as it is, is within nothing
        self._compiled = kernels.load("shared_trace")

    def __len__(self) -> int:
        return len(self.source)

    def fill(
        self, signals: FloatArray, scale: float, out: NDArray[Any], first: int = 0, end: int | None = None
    ) -> None:
        """Set `out` to `scale` times the cumulants of the demons from `first` up to `end`."""
        end = len(self) if end is None else end
        if self._compiled is not None:
            table = (self.source, self.raw, self.low, self.high)
            self._compiled.cumulate(signals.astype(out.dtype), *table, out.dtype.type(scale), out, first, end)
            return
        some = slice(first, end)
        values = signals[self.source[some]].astype(out.dtype)
        within = (self.low[some] <= values) & (values < self.high[some])
        out[some] = out.dtype.type(scale) * (self.raw[some] * values + within)
