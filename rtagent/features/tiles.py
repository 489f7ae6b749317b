"""Tile coding (thesis, section 4.2.1; Sutton and Barto, section 9.5.4)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray, State
from rtagent.features.coder import parts_of
from rtagent.features.normalise import UnitCube, positions
from rtagent.specs import Spec

Displacement = Literal["asymmetric", "uniform"]
LARGEST = 1 << 62


@dataclass(frozen=True)
class Tilings:
    """Several tilings of one resolution: `tiles` along each signal, over `signals` (all, if none are named).

    `tiles` is one number for all signals or a number for each by its name. The tilings are displaced against
    each other by fractions of a tile: `asymmetric` by 1, 3, 5, … of them along the first, second, third, …
    signal (Miller and Glanz 1996), `uniform` by the same along all. `wrap` names signals that have no ends.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    tilings: int = 8
    tiles: int | Mapping[str, int] = 8
    signals: tuple[str, ...] = ()
    wrap: tuple[str, ...] = ()
    displacement: Displacement = "asymmetric"


class TileCoding:
    """Tile coding over the unit cube of the declared ranges: one active feature for each tiling.

    `layers` are sets of tilings, of any resolutions and over any signals. With `memory` the tiles are hashed to
    so many features (rounded to what is given, no more), and `collisions` counts features that a second tile
    came to share. `bias` adds a feature that is always active, the last one.
    Values outside their range are clipped, and counted in `clipped` by signal.
    """

    def __init__(
        self,
        *,
        state: Mapping[str, Spec],
        layers: tuple[Tilings, ...] = (Tilings(),),
        memory: int = 0,
        bias: bool = False,
    ) -> None:
        if not layers:
            raise SpecError("layers is empty: give at least one set of tilings.")
        self._cube = UnitCube(state)
        self._layers: list[_Layer] = []
        for layer in layers:
            start = sum(before.size for before in self._layers)
            self._layers.append(_Layer(layer, self._cube.names, start))
        tiled = _check_size(sum(layer.size for layer in self._layers), memory)
        self._hash = _Hash(memory) if memory else None
        self._bias = np.array([tiled] if bias else [], dtype=np.intp)
        self.size = tiled + bias
        self.active = sum(layer.tilings for layer in self._layers) + bias

    def encode(self, state: State) -> FeatureVector:
        """Return the active tiles of `state`, shape (signals,); raise `SpecError` for NaN and wrong shapes."""
        unit = self._cube(state)
        tiles = np.concatenate([layer(unit) for layer in self._layers])
        if self._hash is not None:
            return self._hashed(tiles)
        return FeatureVector(np.concatenate((tiles, self._bias)))

    def _hashed(self, tiles: NDArray[np.int64]) -> FeatureVector:
        """Return hashed features; one that several tilings came to share has their number as its value."""
        assert self._hash is not None
        places, counts = np.unique(np.concatenate((self._hash(tiles), self._bias)), return_counts=True)
        return FeatureVector(places, counts.astype(np.float64) if counts.max() > 1 else None)

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._cube.clipped

    @property
    def collisions(self) -> int:
        """How many features of the hashed memory are shared by more than one tile, counted once a tile."""
        return self._hash.collisions if self._hash is not None else 0


class _Layer:
    """The tilings of one resolution, whose tiles are numbered from `start`."""

    def __init__(self, spec: Tilings, names: Sequence[str], start: int) -> None:
        chosen = spec.signals or tuple(names)
        self._places = positions(chosen, names, "signals")
        positions(spec.wrap, chosen, "wrap")
        self.tilings = spec.tilings
        counts = [parts_of(name, spec.tiles, "tiles") for name in chosen]
        if spec.tilings < 1:
            raise SpecError(f"tilings is {spec.tilings}: give at least 1.")
        self._scale = np.array(counts, dtype=np.float64)
        wraps = np.array([name in spec.wrap for name in chosen])
        self._span = np.array([n if wrap else n + 1 for n, wrap in zip(counts, wraps, strict=True)], dtype=np.int64)
        self._wraps = wraps if wraps.any() else None
        self._offsets = _offsets(spec.tilings, len(chosen), spec.displacement)
        each = math.prod(self._span.tolist())
        self.size = each * spec.tilings
        if start + self.size >= LARGEST:
            raise SpecError(f"the layers have over {LARGEST} tiles, more than can be numbered: use fewer signals.")
        strides = [math.prod(self._span[place + 1 :].tolist()) for place in range(len(chosen))]
        self._strides = np.array(strides, dtype=np.int64)
        self._starts = start + np.arange(spec.tilings, dtype=np.int64) * each

    def __call__(self, unit: FloatArray) -> NDArray[np.int64]:
        """Return the tile of each tiling, shape (tilings,)."""
        cells = np.floor(unit[self._places] * self._scale + self._offsets).astype(np.int64)
        # the upper end of a range belongs to the last tile, whatever rounding made of it
        last = np.minimum(cells, self._span - 1)
        cells = last if self._wraps is None else np.where(self._wraps, cells % self._span, last)
        tiles: NDArray[np.int64] = cells @ self._strides + self._starts
        return tiles


class _Hash:
    """Spreads tiles over a memory; knows which tile came to each place first."""

    def __init__(self, memory: int) -> None:
        self._memory = np.uint64(memory)
        self._owner = np.full(memory, -1, dtype=np.int64)
        self._seen: set[int] = set()
        self.collisions = 0

    def __call__(self, tiles: NDArray[np.int64]) -> IndexArray:
        places = (_mixed(tiles.astype(np.uint64)) % self._memory).astype(np.intp)
        if not np.array_equal(self._owner[places], tiles):
            self._settle(places, tiles)
        return places

    def _settle(self, places: IndexArray, tiles: NDArray[np.int64]) -> None:
        for place, tile in zip(places.tolist(), tiles.tolist(), strict=True):
            if self._owner[place] < 0:
                self._owner[place] = tile
            elif self._owner[place] != tile and tile not in self._seen:
                self._seen.add(tile)
                self.collisions += 1


def _mixed(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return well-spread numbers (the finaliser of SplitMix64, Steele and others 2014)."""
    numbers = numbers + np.uint64(0x9E3779B97F4A7C15)
    numbers = (numbers ^ (numbers >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    numbers = (numbers ^ (numbers >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return numbers ^ (numbers >> np.uint64(31))


def _offsets(tilings: int, signals: int, displacement: Displacement) -> FloatArray:
    """Return the displacement of each tiling along each signal, in tiles, shape (tilings, signals)."""
    along = 2 * np.arange(signals) + 1 if displacement == "asymmetric" else np.ones(signals, dtype=np.int64)
    steps = np.outer(np.arange(tilings), along) % tilings
    offsets: FloatArray = steps / tilings
    return offsets


def _check_size(tiled: int, memory: int) -> int:
    if memory < 0:
        raise SpecError(f"memory is {memory}: give the number of features to hash to, or 0 for one for each tile.")
    return memory or tiled
