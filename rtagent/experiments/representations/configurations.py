"""The representations that are compared, declared: 248 tile codings, and nine sizes of selective Kanerva coding."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rtagent.features import FeatureCoder, SelectiveKanerva, TileCoding, Tilings
from rtagent.specs import Spec

DIMENSIONS = (2, 8, 12)
LEAST, MOST = 128, 331_776
"""Features of the smallest and of the largest tile coding (thesis, section 4.3)."""
TILES = {2: (4, 6, 8, 12, 16, 32, 48, 72, 96, 144, 192, 288, 576), 8: (2, 3, 4), 12: (2,)}
"""Tiles along each dimension; of 8 or 12, one tile more would be over the largest number of features."""
PROTOTYPES = (1000, 2000, 4000, 6000, 8000, 10_000, 12_000, 16_000, 20_000)
ETA = 0.025


@dataclass(frozen=True)
class Tiles:
    """So many tilings of so many tiles along each of the dimensions."""

    dimensions: int
    tilings: int
    tiles: int

    @property
    def features(self) -> int:
        """How many tiles there are in all."""
        return self.tilings * int(self.tiles**self.dimensions)


def coder_of(settings: Mapping[str, Any], state: Mapping[str, Spec]) -> FeatureCoder:
    """Return the coder that a cell describes.

    Tilings are displaced by the knight's move of Miller and Glanz (1996), and cover the ranges wherever they are:
    of n tiles along a dimension, n - 1 are as wide as it.
    """
    if "prototypes" in settings:
        sizes = {"prototypes": settings["prototypes"], "eta": settings.get("eta", ETA), "seed": settings["seed"]}
        return SelectiveKanerva(state=state, **sizes)
    return TileCoding(state=state, layers=(Tilings(settings["tilings"], settings["tiles"] - 1),))


def tile_codings(dimensions: int) -> list[Tiles]:
    """Return the declared tile codings of so many dimensions, `LEAST` to `MOST` features each: 92, 75 and 81."""
    return [each for each in _series(dimensions) if LEAST <= each.features <= MOST]


def _series(dimensions: int) -> Iterator[Tiles]:
    """Yield numbers of tilings for each number of tiles: of 3 or 4 in 8 dimensions, and of 12, all there are."""
    doubling = [2**power for power in range(11)]
    for tiles in TILES[dimensions]:
        if dimensions == 2:
            tilings: Sequence[int] = doubling
        elif (dimensions, tiles) == (8, 2):
            tilings = sorted({*doubling, *(3 * number for number in doubling[:9])})
        else:
            tilings = range(1, MOST // tiles**dimensions + 1)
        yield from (Tiles(dimensions, number, tiles) for number in tilings)
