"""How selective Kanerva coding finds the nearest prototypes: in plain numpy, or compiled. Both give the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import ModuleType
from typing import Protocol

import numpy as np

from rtagent import kernels, memory
from rtagent.experience import FeatureVector, FloatArray, IndexArray, State
from rtagent.features.coder import vector
from rtagent.features.normalise import UnitCube
from rtagent.features.prototypes import Distance, distances, lengths, metric, smallest

LISTED = 4
"""A neighbour list has room for so many times the prototypes that are active."""


@dataclass(frozen=True)
class Selection:
    """What is selected: from each set of `prototypes`, shape (K, signals), the nearest of each layer.

    The sets lie between successive `bounds`; `counts` has a row for each, with falling numbers for its layers.
    """

    prototypes: FloatArray
    bounds: Sequence[int]
    counts: Sequence[Sequence[int]]
    distance: Distance
    proximity: bool

    @property
    def active(self) -> int:
        """How many features are active."""
        return sum(map(sum, self.counts))


class Selector(Protocol):
    """Makes features of states."""

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`, set by set and, in each, layer by layer."""

    def encode_each(self, states: FloatArray) -> tuple[IndexArray, FloatArray | None]:
        """Return the features of successive states, a row each: their indices, and their values if any."""

    def moved(self, places: IndexArray) -> None:
        """Follow what was written to some of the prototypes."""


def selector(cube: UnitCube, selection: Selection) -> Selector:
    """Return what makes features of a state: compiled where there is a compiler."""
    module = kernels.load("kanerva")
    return PlainSelector(cube, selection) if module is None else CompiledSelector(cube, selection, module)


class PlainSelector:
    """Sorts out the nearest prototypes by their distances (Algorithm 5)."""

    def __init__(self, cube: UnitCube, selection: Selection) -> None:
        self._cube, self._selection = cube, selection

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`, set by set and, in each, layer by layer."""
        point, made = self._cube(state), self._selection
        chosen: list[IndexArray] = []
        values: list[FloatArray] = []
        for (start, end), counts in zip(pairwise(made.bounds), made.counts, strict=True):
            measured = distances(made.prototypes[start:end], point, made.distance)
            nearest = np.arange(end - start)
            for layer, count in enumerate(counts):
                values.append(self._values(measured, count))
                nearest = nearest[smallest(measured[nearest], count)]
                chosen.append(nearest + start + layer * len(made.prototypes))
        return FeatureVector(np.concatenate(chosen), np.concatenate(values) if made.proximity else None)

    def encode_each(self, states: FloatArray) -> tuple[IndexArray, FloatArray | None]:
        """Return the features of successive states, a row each."""
        coded = [self.encode(state) for state in states]
        indices = np.array([each.indices for each in coded], np.intp).reshape(len(states), -1)
        return indices, np.array([each.values for each in coded]) if self._selection.proximity else None

    def moved(self, places: IndexArray) -> None:
        """Do nothing: prototypes are read each time."""

    def _values(self, measured: FloatArray, count: int) -> FloatArray:
        """Return by how much each of the nearest is nearer than the first left out, summing to `count`."""
        if not self._selection.proximity:
            return np.ones(count)
        nearest = lengths(measured[smallest(measured, count)], self._selection.distance)
        farther = lengths(measured[smallest(measured, count + 1)], self._selection.distance).max()
        weights: FloatArray = 1.0 - nearest / farther if farther > 0 else np.zeros(count)
        total = weights.cumsum()[-1]
        return weights * (count / total) if total > 0 else np.ones(count)


class CompiledSelector:
    """Asks a list of neighbours, kept from an earlier state, or else all prototypes; see `rtagent.kernels.kanerva`.

    The lists only make it quicker, and change no result. One thread at a time may use it.
    """

    def __init__(self, cube: UnitCube, selection: Selection, module: ModuleType) -> None:
        self._cube, self._active = cube, selection.active
        self._values = np.empty(selection.active if selection.proximity else 0)
        self._proximity = selection.proximity
        signals = selection.prototypes.shape[1]
        sets, layers, room = len(selection.counts), len(selection.counts[0]), _room(selection)
        columns, places = with_room(selection.prototypes, sets * room)
        plan = np.array(
            [metric(selection.distance), sets, layers, room, selection.proximity, *selection.bounds]
            + [count for counts in selection.counts for count in counts]
        )
        remembered = np.full((sets, module.ANCHOR + signals + layers), 0.1)
        remembered[:, module.LISTED], remembered[:, module.GAP] = 0.0, np.inf
        self._prototypes, self._columns = selection.prototypes, columns
        self._lists = remembered[:, module.LISTED]
        store = cube.ranges(2), cube.clips, selection.prototypes, columns, places, plan, remembered
        self._nearest = partial(module.nearest, *store)

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`, set by set and, in each, layer by layer."""
        indices = np.empty(self._active, np.intp)
        values = np.empty(self._active) if self._proximity else self._values
        try:
            wrong = self._nearest(np.asarray(state, np.float64, "C"), indices, values)
        except (TypeError, ValueError):  # no numbers, not one row of them, or not aligned
            wrong = self._nearest(self._cube.inside(state), indices, values)
        if wrong >= 0:
            raise self._cube.refusal(state)
        return vector((indices, values if self._proximity else None))

    def encode_each(self, states: FloatArray) -> tuple[IndexArray, FloatArray | None]:
        """Return the features of successive states, a row each."""
        rows = np.require(states, np.float64, ["C", "W"])
        indices = np.empty((len(rows), self._active), np.intp)
        values = np.empty((len(rows), self._active if self._proximity else 0))
        for state, chosen, weights in zip(rows, indices, values, strict=True):
            if self._nearest(state, chosen, weights) >= 0:
                raise self._cube.refusal(state)
        return indices, values if self._proximity else None

    def moved(self, places: IndexArray) -> None:
        """Follow what was written to some of the prototypes: no list answers any more."""
        self._columns[:-1, places] = self._prototypes[places].T
        self._lists[:] = 0.0


def with_room(prototypes: FloatArray, room: int) -> tuple[np.ndarray, IndexArray]:
    """Return the prototypes as kernels read them: columns of float32, and whose they are, with room for more."""
    count, signals = prototypes.shape
    memory.claim((4 * (signals + 1) + 8) * (count + room), "prototypes, as the kernels read them")
    columns = np.zeros((signals + 1, count + room), dtype=np.float32)
    columns[:-1, :count] = prototypes.T
    return columns, np.arange(count + room)


def _room(selection: Selection) -> int:
    """Return for how many a list of neighbours has room; one of a whole set is none."""
    most = max(counts[0] for counts in selection.counts) + selection.proximity
    return LISTED * most
