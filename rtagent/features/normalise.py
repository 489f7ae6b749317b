"""Normalisation: signals to the unit cube, from their declared ranges; what lies outside is clipped and counted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FloatArray, State
from rtagent.specs import Spec


class UnitCube:
    """Maps a state, shape (signals,), to the unit cube. `clipped` counts values outside their range, by signal.

    Raises `SpecError` for a signal without a finite range, or that is an array.
    """

    def __init__(self, state: Mapping[str, Spec]) -> None:
        self.names = tuple(state)
        for name, spec in state.items():
            _check_range(name, spec)
        self._low = np.array([spec.low for spec in state.values()], dtype=np.float64)
        self._high = np.array([spec.high for spec in state.values()], dtype=np.float64)
        self._span = self._high - self._low
        self.clipped = dict.fromkeys(self.names, 0)

    def __call__(self, state: State) -> FloatArray:
        """Return the state in the unit cube; raise `SpecError`, naming the signal, for one that is not a number."""
        values = np.asarray(state, dtype=np.float64)
        if values.shape != self._low.shape:
            raise SpecError(
                f"the state has shape {values.shape}: give one value for each of {len(self.names)} signals."
            )
        clipped = np.minimum(np.maximum(values, self._low), self._high)
        if not np.array_equal(values, clipped):
            self._count(values)
        unit: FloatArray = (clipped - self._low) / self._span
        return unit

    def _count(self, values: FloatArray) -> None:
        for name, value, low, high in zip(self.names, values, self._low, self._high, strict=True):
            if math.isnan(value):
                raise SpecError(f"signal {name!r} is not a number (NaN): nothing is learned from it.")
            self.clipped[name] += not low <= value <= high


def _check_range(name: str, spec: Spec) -> None:
    if spec.shape:
        raise SpecError(f"signal {name!r} is an array of shape {spec.shape}: only a number can be normalised.")
    if not (math.isfinite(spec.low) and math.isfinite(spec.high) and spec.low < spec.high):
        raise SpecError(f"signal {name!r} has no finite range to normalise by: declare low and high.")


def positions(names: Sequence[str], known: Sequence[str], of: str) -> list[int]:
    """Return where each of `names` stands among the `known` signals; raise `SpecError` for one that is none."""
    for name in names:
        if name not in known:
            raise SpecError(f"{of} names the signal {name!r}; the state has {', '.join(known)}.")
    return [known.index(name) for name in names]
