"""Normalisation: signals to the unit cube, from their declared ranges; what lies outside is counted, never kept."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FloatArray, State
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import Spec

Outside = Literal["clip", "mask"]


class UnitCube:
    """Maps a state, shape (signals,), to the unit cube.

    A value `outside` its declared range is clipped to it and counted in `clips`, one that is not a number (NaN)
    refused; or it is masked: the signal keeps its last value that was inside (before there was one, the middle
    of its range), which is counted in `masks`. Both counts are arrays of shape (signals,).
    Raises `SpecError` for a signal without a finite range, or that is an array.
    """

    def __init__(self, state: Mapping[str, Spec], outside: Outside = "clip") -> None:
        if outside not in get_args(Outside):
            raise SpecError(f"outside is {outside!r}: give 'clip' or 'mask'.")
        self.names = tuple(state)
        for name, spec in state.items():
            _check_range(name, spec)
        self.low: FloatArray = np.array([spec.low for spec in state.values()], dtype=np.float64)
        self.high: FloatArray = np.array([spec.high for spec in state.values()], dtype=np.float64)
        self.span: FloatArray = self.high - self.low
        self.clips = np.zeros(len(self.names), dtype=np.int64)
        self.masks = np.zeros(len(self.names), dtype=np.int64)
        self.last: FloatArray = self.low + self.span / 2
        self._shape = self.low.shape
        self._settled = self._masked if outside == "mask" else self._clipped

    def __call__(self, state: State) -> FloatArray:
        """Return the state in the unit cube; raise `SpecError` as `inside` does."""
        unit: FloatArray = (self.inside(state) - self.low) / self.span
        return unit

    def point(self, state: State) -> FloatArray:
        """Return the state in the unit cube, clipped, without counting; raise `SpecError` for another shape."""
        unit: FloatArray = (np.clip(self._values(state), self.low, self.high) - self.low) / self.span
        return unit

    def inside(self, state: State) -> FloatArray:
        """Return the state within its ranges, in its own units.

        Raises `SpecError` for another shape, and, naming the signal, for a NaN that is not to be masked.
        """
        return self._settled(self._values(state))

    def refusal(self, state: State) -> SpecError:
        """Return what is said of a state that does not fit, or has a signal that is not a number."""
        expected = f"give one value for each of {len(self.names)} signals ({', '.join(self.names)})"
        try:
            values = np.asarray(state, np.float64)
        except (TypeError, ValueError):
            return SpecError(f"the state {state!r} is not a sequence of numbers: {expected}.")
        if values.shape != self._shape:
            return SpecError(f"the state has shape {values.shape}: {expected}.")
        name = self.names[int(np.isnan(values).argmax())]
        return SpecError(f"signal {name!r} is not a number (NaN): nothing is learned from it.")

    def ranges(self, spare: int) -> FloatArray:
        """Return what kernels normalise with: the ends of the signals, and so many `spare` rows to write to."""
        return np.vstack((self.low, self.high, np.full((spare, len(self.names)), np.inf)))

    @property
    def clipped(self) -> dict[str, int]:
        """How many values were clipped to their range, by signal."""
        return dict(zip(self.names, self.clips.tolist(), strict=True))

    @property
    def masked(self) -> dict[str, int]:
        """How many values were disregarded, by signal."""
        return dict(zip(self.names, self.masks.tolist(), strict=True))

    def save(self) -> Saved:
        """Return the counts and the last values that were inside."""
        return save_fields(self, ("clips", "masks", "last"))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of other signals."""
        restore_fields(self, ("clips", "masks", "last"), saved)

    def _values(self, state: State) -> FloatArray:
        try:
            values = np.asarray(state, np.float64)
        except (TypeError, ValueError):
            raise self.refusal(state) from None
        if values.shape != self._shape:
            raise self.refusal(state)
        return values

    def _clipped(self, values: FloatArray) -> FloatArray:
        clipped: FloatArray = np.minimum(np.maximum(values, self.low), self.high)
        if not np.array_equal(values, clipped):
            if math.isnan(clipped.sum()):
                raise self.refusal(values)
            self.clips += values != clipped
        return clipped

    def _masked(self, values: FloatArray) -> FloatArray:
        inside = (values >= self.low) & (values <= self.high)
        self.masks += ~inside
        self.last[inside] = values[inside]
        return self.last.copy()


def _check_range(name: str, spec: Spec) -> None:
    if spec.shape:
        raise SpecError(f"signal {name!r} is an array of shape {spec.shape}: only a number can be normalised.")
    if not (math.isfinite(spec.high - spec.low) and spec.low < spec.high):
        raise SpecError(f"signal {name!r} has no finite range to normalise by: declare low and high.")


def positions(names: Sequence[str], known: Sequence[str], of: str) -> list[int]:
    """Return where each of `names` stands among the `known` signals; raise `SpecError` for one that is none."""
    for name in names:
        if name not in known:
            raise SpecError(f"{of} names the signal {name!r}; the state has {', '.join(known)}.")
    return [known.index(name) for name in names]
