"""Tables: one feature for each state, for each value of each signal, or for each bin."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from math import ceil, floor

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, State
from rtagent.features.coder import parts_of
from rtagent.specs import Spec


class Tabular:
    """One feature for each state: signals with finitely many values, one feature active."""

    active = 1

    def __init__(self, *, state: Mapping[str, Spec]) -> None:
        self._axes = [_DiscreteAxis(name, spec) for name, spec in state.items()]
        self.size = math.prod(axis.count for axis in self._axes)
        self._vectors = _Vectors()

    def encode(self, state: State) -> FeatureVector:
        """Return the one active feature of `state` (shape: one value for each signal)."""
        index = 0
        for axis, value in zip(self._axes, state, strict=True):
            index = index * axis.count + axis.place(value)
        return self._vectors[(index,)]


class OneHot:
    """One feature for each value of each signal: as many active as there are signals."""

    def __init__(self, *, state: Mapping[str, Spec]) -> None:
        self._axes = [_DiscreteAxis(name, spec) for name, spec in state.items()]
        self.size = sum(axis.count for axis in self._axes)
        self.active = len(self._axes)
        self._vectors = _Vectors()

    def encode(self, state: State) -> FeatureVector:
        """Return the active features of `state`, one for each signal."""
        return self._vectors[tuple(self._indices(state))]

    def _indices(self, state: State) -> Iterator[int]:
        offset = 0
        for axis, value in zip(self._axes, state, strict=True):
            yield offset + axis.place(value)
            offset += axis.count


class Binned:
    """A table over continuous signals, each cut into `bins` equal parts: one feature active."""

    active = 1

    def __init__(self, *, state: Mapping[str, Spec], bins: int | Mapping[str, int] = 10) -> None:
        self._axes = [_BinnedAxis(name, spec, bins) for name, spec in state.items()]
        self.size = math.prod(axis.count for axis in self._axes)
        self._vectors = _Vectors()

    def encode(self, state: State) -> FeatureVector:
        """Return the one active feature of `state`; the upper end of a range belongs to its last bin."""
        index = 0
        for axis, value in zip(self._axes, state, strict=True):
            index = index * axis.count + axis.place(value)
        return self._vectors[(index,)]


class _Vectors(dict[tuple[int, ...], FeatureVector]):
    """Feature vectors by their indices, made once each and never written to."""

    def __missing__(self, indices: tuple[int, ...]) -> FeatureVector:
        array = np.array(indices, dtype=np.intp)
        array.setflags(write=False)
        vector = self[indices] = FeatureVector(array)
        return vector


class _DiscreteAxis:
    def __init__(self, name: str, spec: Spec) -> None:
        self.name = name
        try:
            self.count = spec.count
        except SpecError as error:
            raise SpecError(f"signal {name!r}: {error}") from None
        self._low, self._high = ceil(spec.low), floor(spec.high)

    def place(self, value: float) -> int:
        if not self._low <= value <= self._high or value != int(value):  # NaN is refused by the first
            raise SpecError(f"signal {self.name!r} is {value}: none of {self._low} to {self._high}.")
        return int(value) - self._low


class _BinnedAxis:
    def __init__(self, name: str, spec: Spec, bins: int | Mapping[str, int]) -> None:
        self.name = name
        self.count = parts_of(name, bins, "bins")
        if spec.shape:
            raise SpecError(f"signal {name!r} is an array of shape {spec.shape}: only a single number has bins.")
        if not (math.isfinite(spec.low) and math.isfinite(spec.high)):
            raise SpecError(f"signal {name!r} has no finite range to cut into bins: declare low and high.")
        self._low, self._high = spec.low, spec.high
        self._scale = self.count / (spec.high - spec.low) if spec.high > spec.low else 0.0

    def place(self, value: float) -> int:
        if not self._low <= value <= self._high:
            raise SpecError(f"signal {self.name!r} is {value}, outside {self._low:g} to {self._high:g}.")
        return min(int((value - self._low) * self._scale), self.count - 1)
