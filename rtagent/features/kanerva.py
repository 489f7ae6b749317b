"""Kanerva coding and selective Kanerva coding (thesis, sections 4.2.2, 4.2.3 and 6.2)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from rtagent import kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray, State
from rtagent.features.coder import vector
from rtagent.features.normalise import UnitCube
from rtagent.features.prototypes import Distance, distances, limit, metric, placed
from rtagent.features.selection import Selection, selector, with_room
from rtagent.saving import Saved
from rtagent.specs import Spec


class SelectiveKanerva:
    """The c = floor(K · eta) prototypes nearest to the state are active (Algorithm 5), ties to the lower number.

    `prototypes` is K, drawn uniformly from `seed`, or the prototypes themselves, shape (K, signals), in the unit
    cube. Several `sets` share K between them (thesis, 6.2.1); several values of `eta` give every prototype a
    feature each (6.2.2). With `proximity` the features are real-valued: 1 minus the distance as a fraction of
    that of the nearest prototype left out, scaled so that they sum to c. Values outside their range are clipped,
    and counted in `clipped` by signal.
    Raises `SpecError` for an eta that leaves nothing, or not less than everything, active.
    """

    def __init__(
        self,
        *,
        state: Mapping[str, Spec],
        prototypes: int | NDArray[np.float64] = 1000,
        eta: float | tuple[float, ...] = 0.025,
        sets: int = 1,
        distance: Distance = "euclidean",
        proximity: bool = False,
        seed: int = 0,
    ) -> None:
        self._cube = UnitCube(state)
        metric(distance)
        self.prototypes = placed(prototypes, len(state), seed)
        bounds, etas = _bounds(len(self.prototypes), sets), _ratios(eta)
        counts = [[_count(end - start, each) for each in etas] for start, end in pairwise(bounds)]
        selection = Selection(self.prototypes, bounds, counts, distance, proximity)
        self._selector = selector(self._cube, selection)
        self._encode = self._selector.encode
        self.size = len(self.prototypes) * len(etas)
        self.active = selection.active

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`: for each set, and each eta, the largest first, the nearest prototypes.

        Raises `SpecError` for another shape, and, naming the signal, for a value that is not a number.
        """
        return self._encode(state)

    def encode_each(self, states: FloatArray) -> tuple[IndexArray, FloatArray | None]:
        """Return what `encode` would of states, shape (n, signals): indices and values, shape (n, active).

        Values are None where all are 1. Raises `SpecError` as `encode` does, for the first state that is wrong.
        """
        return self._selector.encode_each(states)

    def point(self, state: State) -> FloatArray:
        """Return where a state lies in the unit cube, shape (signals,), clipped without being counted."""
        return self._cube.point(state)

    def moved(self, places: IndexArray) -> None:
        """Follow what was written to some of the `prototypes`."""
        self._selector.moved(places)

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._cube.clipped

    def save(self) -> Saved:
        """Return the counts; the prototypes follow from the settings."""
        return self._cube.save()

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self._cube.restore(saved)


def _bounds(prototypes: int, sets: int) -> list[int]:
    if not 1 <= sets <= prototypes:
        raise SpecError(f"sets is {sets}: give a number from 1 to that of the prototypes.")
    bounds: list[int] = np.linspace(0, prototypes, sets + 1).astype(int).tolist()
    return bounds


def _ratios(eta: float | tuple[float, ...]) -> list[float]:
    ratios = sorted(np.atleast_1d(np.asarray(eta, dtype=np.float64)).tolist(), reverse=True)
    if not ratios:
        raise SpecError("eta is empty: give at least one ratio.")
    return ratios


def _count(prototypes: int, eta: float) -> int:
    """Return c = floor(K · eta), where a product that is whole but for rounding counts as whole."""
    count = int(np.floor(prototypes * eta + 1e-9)) if np.isfinite(eta) else 0
    if not 1 <= count < prototypes:
        raise SpecError(
            f"eta {eta} of {prototypes} prototypes makes {count} of them active: "
            f"give a ratio from {1 / prototypes:g} to below 1, or more prototypes."
        )
    return count


class KanervaCoding:
    """Prototypes within `radius` of the state are active (Algorithm 4); the state is in the unit cube.

    `prototypes` is their number, drawn uniformly from `seed`, or they themselves, shape (K, signals).
    """

    def __init__(
        self,
        *,
        state: Mapping[str, Spec],
        prototypes: int | NDArray[np.float64] = 1000,
        radius: float = 0.2,
        distance: Distance = "euclidean",
        seed: int = 0,
    ) -> None:
        if not 0 < radius < np.inf:
            raise SpecError(f"radius is {radius}: give a distance above 0.")
        self._cube = UnitCube(state)
        metric(distance)
        self.prototypes = placed(prototypes, len(state), seed)
        self._encode = _finder(self._cube, self.prototypes, radius, distance)
        self.size = self.active = len(self.prototypes)

    def encode(self, state: State) -> FeatureVector:
        """Return the prototypes that are nearer than the radius, shape (as many as there are,).

        Raises `SpecError` for another shape, and, naming the signal, for a value that is not a number.
        """
        return self._encode(state)

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._cube.clipped

    def save(self) -> Saved:
        """Return the counts; the prototypes follow from the settings."""
        return self._cube.save()

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self._cube.restore(saved)


def _finder(
    cube: UnitCube, prototypes: FloatArray, radius: float, distance: Distance
) -> Callable[[State], FeatureVector]:
    module = kernels.load("kanerva")
    if module is None:
        return _PlainFinder(cube, prototypes, radius, distance).encode
    return _CompiledFinder(cube, prototypes, radius, distance, module).encode


class _PlainFinder:
    """Compares all distances with the radius."""

    def __init__(self, cube: UnitCube, prototypes: FloatArray, radius: float, distance: Distance) -> None:
        self._cube, self._prototypes, self._distance = cube, prototypes, distance
        self._limit = limit(radius, distance)

    def encode(self, state: State) -> FeatureVector:
        measured = distances(self._prototypes, self._cube(state), self._distance)
        return FeatureVector(np.flatnonzero(measured < self._limit))


class _CompiledFinder:
    """The same, compiled; one thread at a time may use it."""

    def __init__(
        self, cube: UnitCube, prototypes: FloatArray, radius: float, distance: Distance, module: ModuleType
    ) -> None:
        self._cube, self._chosen = cube, np.empty(len(prototypes), np.intp)
        columns, places = with_room(prototypes, 0)
        asked = metric(distance), limit(radius, distance)
        self._within = partial(module.within, cube.ranges(1), cube.clips, prototypes, columns, places, *asked)

    def encode(self, state: State) -> FeatureVector:
        try:
            found = self._within(np.asarray(state, np.float64, "C"), self._chosen)
        except (TypeError, ValueError):  # no numbers, not one row of them, or not aligned
            found = self._within(self._cube.inside(state), self._chosen)
        if found < 0:
            raise self._cube.refusal(state)
        return vector((self._chosen[:found].copy(), None))
