"""Kanerva coding and selective Kanerva coding (thesis, sections 4.2.2, 4.2.3 and 6.2): the plain numpy form."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray, State
from rtagent.features.normalise import UnitCube
from rtagent.specs import Spec

Distance = Literal["euclidean", "city_block", "max"]

DISTANCES: dict[Distance, Callable[[FloatArray], FloatArray]] = {
    "euclidean": lambda difference: np.sqrt(np.square(difference).sum(axis=1)),
    "city_block": lambda difference: np.abs(difference).sum(axis=1),
    "max": lambda difference: np.abs(difference).max(axis=1),
}


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
        if not radius > 0:
            raise SpecError(f"radius is {radius}: give a distance above 0.")
        self._cube, self._radius, self._distance = UnitCube(state), radius, DISTANCES[distance]
        self.prototypes = _placed(prototypes, len(state), np.random.default_rng(seed))
        self.size = self.active = len(self.prototypes)

    def encode(self, state: State) -> FeatureVector:
        """Return the prototypes that are nearer than the radius, shape (as many as there are,)."""
        distances = self._distance(self.prototypes - self._cube(state))
        return FeatureVector(np.flatnonzero(distances < self._radius))

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._cube.clipped


class SelectiveKanerva:
    """The c = floor(K · eta) prototypes nearest to the state are active (Algorithm 5), ties to the lower number.

    `prototypes` is K, drawn uniformly from `seed`, or the prototypes themselves, shape (K, signals), in the unit
    cube. Several `sets` share K between them (thesis, 6.2.1); several values of `eta` give every prototype a
    feature each (6.2.2). With `proximity` the features are real-valued: 1 minus the distance as a fraction of
    that of the nearest prototype left out, scaled so that they sum to c.
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
        self._cube, self._distance, self._proximity = UnitCube(state), DISTANCES[distance], proximity
        self.prototypes = _placed(prototypes, len(state), np.random.default_rng(seed))
        if not 1 <= sets <= len(self.prototypes):
            raise SpecError(f"sets is {sets}: give a number from 1 to that of the prototypes.")
        etas = sorted(eta if isinstance(eta, tuple) else (eta,), reverse=True)
        if not etas:
            raise SpecError("eta is empty: give at least one ratio.")
        bounds = np.linspace(0, len(self.prototypes), sets + 1).astype(int).tolist()
        self._sets = [
            (start, self.prototypes[start:end], [_count(end - start, each) for each in etas])
            for start, end in pairwise(bounds)
        ]
        self.size = len(self.prototypes) * len(etas)
        self.active = sum(sum(counts) for _, _, counts in self._sets)

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`: for each eta, the largest first, the nearest prototypes of each set."""
        point = self._cube(state)
        chosen: list[tuple[IndexArray, FloatArray]] = []
        for start, prototypes, counts in self._sets:
            distances = self._distance(prototypes - point)
            nearest = np.arange(len(prototypes))
            for layer, count in enumerate(counts):
                values = self._values(distances, count) if self._proximity else np.ones(count)
                nearest = nearest[smallest(distances[nearest], count)]
                chosen.append((nearest + start + layer * len(self.prototypes), values))
        indices = np.concatenate([places for places, _ in chosen])
        return FeatureVector(indices, np.concatenate([values for _, values in chosen]) if self._proximity else None)

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._cube.clipped

    def _values(self, distances: FloatArray, count: int) -> FloatArray:
        nearest = distances[smallest(distances, count)]
        farther = distances[smallest(distances, count + 1)].max()
        weights: FloatArray = 1.0 - nearest / farther if farther > 0 else np.zeros(count)
        total = weights.sum()
        return weights * (count / total) if total > 0 else np.ones(count)


def smallest(distances: FloatArray, count: int) -> IndexArray:
    """Return where the `count` smallest distances stand, in rising order of place; ties to the lower place."""
    if count >= len(distances):
        return np.arange(len(distances))
    threshold = np.partition(distances, count - 1)[count - 1]
    below = np.flatnonzero(distances < threshold)
    ties = np.flatnonzero(distances == threshold)[: count - len(below)]
    return np.sort(np.concatenate((below, ties)))


def _count(prototypes: int, eta: float) -> int:
    """Return c = floor(K · eta), where a product that is whole but for rounding counts as whole."""
    count = int(np.floor(prototypes * eta + 1e-9))
    if not 1 <= count < prototypes:
        raise SpecError(
            f"eta {eta} of {prototypes} prototypes makes {count} of them active: "
            f"give a ratio from {1 / prototypes:g} to below 1, or more prototypes."
        )
    return count


def _placed(prototypes: int | NDArray[np.float64], signals: int, rng: np.random.Generator) -> FloatArray:
    if isinstance(prototypes, int):
        if prototypes < 2:
            raise SpecError(f"prototypes is {prototypes}: give at least 2.")
        return rng.random((prototypes, signals))
    placed = np.array(prototypes, dtype=np.float64)
    if placed.ndim != 2 or placed.shape[1] != signals or len(placed) < 2:
        raise SpecError(f"the prototypes have shape {placed.shape}: give (2 or more, {signals}).")
    if not np.all((placed >= 0) & (placed <= 1)):
        raise SpecError("a prototype lies outside the unit cube: normalise it by the declared ranges.")
    return placed


class SparseMemory:
    """Sparse distributed memory (thesis, section 2.4; Kanerva 1988): binary addresses, real values.

    `addresses` has shape (prototypes, bits), of 0 and 1; one is activated by an address at a Hamming distance
    below `radius`. Writing moves each activated value to the average of all that was written to it.
    """

    def __init__(self, addresses: NDArray[np.integer] | Sequence[Sequence[int]], radius: int) -> None:
        self._addresses = np.asarray(addresses)
        if self._addresses.ndim != 2 or not np.isin(self._addresses, (0, 1)).all():
            raise SpecError("addresses are rows of bits, 0 and 1: give an array of shape (prototypes, bits).")
        if radius < 1:
            raise SpecError(f"radius is {radius}: give a Hamming distance of 1 or more.")
        self._radius = radius
        self._sums: FloatArray = np.zeros(len(self._addresses))
        self._writes: FloatArray = np.zeros(len(self._addresses))

    def activated(self, address: NDArray[np.integer] | Sequence[int]) -> IndexArray:
        """Return the prototypes that `address`, shape (bits,), activates."""
        bits = np.asarray(address)
        if bits.shape != self._addresses.shape[1:]:
            raise SpecError(f"an address has shape {bits.shape}: give {self._addresses.shape[1]} bits.")
        return np.flatnonzero((self._addresses != bits).sum(axis=1) < self._radius)

    def write(self, address: NDArray[np.integer] | Sequence[int], value: float) -> None:
        """Write a value to every activated prototype."""
        places = self.activated(address)
        self._sums[places] += value
        self._writes[places] += 1

    def read(self, address: NDArray[np.integer] | Sequence[int]) -> float | None:
        """Return the average of the activated prototypes that were written to, or None where there are none."""
        places = self.activated(address)
        places = places[self._writes[places] > 0]
        return float(np.mean(self._sums[places] / self._writes[places])) if len(places) else None
