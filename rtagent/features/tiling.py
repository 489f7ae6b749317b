"""How tile coding finds its features: in plain numpy, or compiled. Both give the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from types import ModuleType

import numpy as np

from rtagent.experience import FeatureVector, State
from rtagent.features.coder import vector
from rtagent.features.hashing import HashedMemory
from rtagent.features.normalise import UnitCube
from rtagent.features.tilings import Layer

Finder = Callable[[State], FeatureVector]


class PlainTiles:
    """The tiles of all layers, one after the other."""

    def __init__(self, cube: UnitCube, layers: Sequence[Layer]) -> None:
        self._cube, self._layers = cube, layers

    def encode(self, state: State) -> FeatureVector:
        """Return the tile of each tiling, shape (tilings,)."""
        unit = self._cube(state)
        return FeatureVector(np.concatenate([layer(unit) for layer in self._layers]))


class CompiledTiles:
    """The same, by `rtagent.kernels.tiles`."""

    def __init__(self, cube: UnitCube, layers: Sequence[Layer], module: ModuleType) -> None:
        self._cube, self._tilings = cube, sum(layer.tilings for layer in layers)
        rows = [np.array([[layer.tilings, len(layer.places), layer.start, layer.each]]) for layer in layers]
        axes = [np.column_stack((layer.places, layer.spans, layer.strides, layer.wraps)) for layer in layers]
        offsets = [np.column_stack((layer.counts, layer.offsets.T)).ravel() for layer in layers]
        plan = np.concatenate(rows + axes).astype(np.int64)
        layout = cube.ranges(1), cube.clips, len(layers), plan, np.concatenate(offsets)
        self._find = partial(module.find, *layout)

    def encode(self, state: State) -> FeatureVector:
        """Return the tile of each tiling, shape (tilings,)."""
        tiles = np.empty(self._tilings, np.intp)
        try:
            wrong = self._find(np.asarray(state, np.float64, "C"), tiles)
        except (TypeError, ValueError):  # no numbers, not one row of them, or not aligned
            wrong = self._find(self._cube.inside(state), tiles)
        if wrong >= 0:
            raise self._cube.refusal(state)
        return vector((tiles, None))


class PlainHash:
    """Puts tiles into a hashed memory; features that are `always` active are added."""

    def __init__(self, find: Finder, memory: HashedMemory, always: Sequence[int]) -> None:
        self._find, self._memory, self._always = find, memory, np.array(always, dtype=np.intp)

    def encode(self, state: State) -> FeatureVector:
        """Return each feature once; where several tiles share one, how many they are as its value."""
        places = self._memory(self._find(state).indices)
        indices, counts = np.unique(np.concatenate((places, self._always)), return_counts=True)
        return FeatureVector(indices, counts.astype(np.float64) if counts.max() > 1 else None)


class CompiledHash:
    """The same, by `rtagent.kernels.tiles`."""

    def __init__(self, find: Finder, memory: HashedMemory, always: Sequence[int], module: ModuleType) -> None:
        self._find, self._memory, self._always = find, memory, np.array(always, dtype=np.intp)
        self._place, self._merge = module.place, module.merge

    def encode(self, state: State) -> FeatureVector:
        """Return each feature once; where several tiles share one, how many they are as its value."""
        tiles = self._find(state).indices
        indices = np.concatenate((tiles, self._always))
        counts = np.empty(len(indices))
        if self._place(tiles, indices, self._memory.owners):
            self._memory.count(tiles, indices[: len(tiles)])
        kept = self._merge(indices, counts)
        return FeatureVector(indices[:kept], counts[:kept] if kept < len(indices) else None)
