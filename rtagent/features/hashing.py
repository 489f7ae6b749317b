"""Hashing: tiles in a memory that has fewer places than there are tiles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import IndexArray
from rtagent.memory import claim
from rtagent.saving import Saved, restore_fields, save_fields


class HashedMemory:
    """Spreads tiles over `places`; `owners` says which tile came to each first (-1: none).

    `collisions` counts the tiles that came to a place that another owns.
    """

    def __init__(self, places: int) -> None:
        claim(8 * places, "the memory of hashed tiles")
        self.owners = np.full(places, -1, dtype=np.int64)
        self.collisions = 0
        self._seen: set[int] = set()

    def __call__(self, tiles: NDArray[np.int64]) -> IndexArray:
        """Return the place of each tile, shape (tiles,), which takes it where it is free."""
        places = (_mixed(tiles.astype(np.uint64)) % np.uint64(len(self.owners))).astype(np.intp)
        for place, tile in zip(places.tolist(), tiles.tolist(), strict=True):
            if self.owners[place] < 0:
                self.owners[place] = tile
        self.count(tiles, places)
        return places

    def count(self, tiles: NDArray[np.int64], places: IndexArray) -> None:
        """Count the tiles, at these places, that another owns, each once for ever."""
        for tile in tiles[self.owners[places] != tiles].tolist():
            if tile not in self._seen:
                self._seen.add(tile)
                self.collisions += 1

    def save(self) -> Saved:
        """Return who owns what, and which tiles were counted."""
        return save_fields(self, ("owners", "collisions")) | {"seen": np.array(sorted(self._seen), dtype=np.int64)}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of another size."""
        if "seen" not in saved:
            raise SpecError("the saved state of HashedMemory has no 'seen': it is of something else.")
        restore_fields(self, ("owners", "collisions"), saved)
        self._seen = set(saved["seen"].tolist())


def _mixed(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return well-spread numbers (the finaliser of SplitMix64, Steele and others 2014)."""
    numbers = numbers + np.uint64(0x9E3779B97F4A7C15)
    numbers = (numbers ^ (numbers >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    numbers = (numbers ^ (numbers >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return numbers ^ (numbers >> np.uint64(31))
