"""Tile coding (thesis, section 4.2.1; Sutton and Barto, section 9.5.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent import kernels
from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, State
from rtagent.features.hashing import HashedMemory
from rtagent.features.normalise import UnitCube
from rtagent.features.tiling import CompiledHash, CompiledTiles, Finder, PlainHash, PlainTiles
from rtagent.features.tilings import Layer, Tilings
from rtagent.saving import Saved
from rtagent.specs import Spec


class TileCoding:
    """Tile coding over the unit cube of the declared ranges: one active feature for each tiling.

    `layers` are sets of tilings, of any resolutions and over any signals. With `memory` the tiles are hashed to
    so many features, and `collisions` counts the tiles that came to a feature that another tile had; one that
    several active tiles share has their number as its value. `bias` adds a feature that is always active, the last.
    Values outside their range are clipped, and counted in `clipped` by signal.
    Raises `SpecError` for layers that cannot be, and for fewer features in memory than there are tilings.
    """

    def __init__(
        self,
        *,
        state: Mapping[str, Spec],
        layers: tuple[Tilings, ...] = (Tilings(),),
        memory: int = 0,
        bias: bool = False,
    ) -> None:
        self._cube = UnitCube(state)
        made = _made(layers, self._cube.names)
        tilings = sum(layer.tilings for layer in made)
        _check_memory(memory, tilings)
        tiled = memory or sum(layer.size for layer in made)
        self.size = tiled + bias
        self.active = tilings + bias
        always = [Layer(Tilings(1, 1), (), tiled)] * bias
        self._hash = HashedMemory(memory) if memory else None
        if self._hash is None:
            self._encode = _finder(self._cube, [*made, *always])
        else:
            self._encode = _hashed(_finder(self._cube, made), self._hash, [tiled] * bias)

    def encode(self, state: State) -> FeatureVector:
        """Return the active tiles of `state`, shape (signals,).

        Raises `SpecError` for another shape, and, naming the signal, for a value that is not a number.
        """
        return self._encode(state)

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._cube.clipped

    @property
    def collisions(self) -> int:
        """How many tiles came to a feature of the hashed memory that another tile had, each counted once."""
        return self._hash.collisions if self._hash else 0

    def save(self) -> Saved:
        """Return the counts, and who owns what in the hashed memory."""
        return {"cube": self._cube.save(), "hash": self._hash.save() if self._hash else None}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError`, changing nothing, where it has other settings."""
        if saved.keys() != {"cube", "hash"} or (saved["hash"] is None) != (self._hash is None):
            raise SpecError("the saved state is not of tile coding, or one of the two has no memory to hash to.")
        before = self._cube.save()
        self._cube.restore(saved["cube"])
        try:
            if self._hash:
                self._hash.restore(saved["hash"])
        except SpecError:
            self._cube.restore(before)
            raise


def _made(layers: Sequence[Tilings], known: Sequence[str]) -> list[Layer]:
    """Return the layers, their tiles numbered one after the other."""
    if not layers:
        raise SpecError("layers is empty: give at least one set of tilings.")
    made: list[Layer] = []
    for layer in layers:
        made.append(Layer(layer, known, sum(before.size for before in made)))
    return made


def _check_memory(memory: int, tilings: int) -> None:
    if memory and memory < tilings:
        raise SpecError(
            f"memory is {memory}: give the number of features to hash to, at least as many as the {tilings} "
            "tilings, or 0 for one for each tile."
        )


def _finder(cube: UnitCube, layers: Sequence[Layer]) -> Finder:
    module = kernels.load("tiles")
    made = PlainTiles(cube, layers) if module is None else CompiledTiles(cube, layers, module)
    return made.encode


def _hashed(find: Finder, memory: HashedMemory, always: Sequence[int]) -> Finder:
    module = kernels.load("tiles")
    made = PlainHash(find, memory, always) if module is None else CompiledHash(find, memory, always, module)
    return made.encode
