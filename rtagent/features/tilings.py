"""Tilings of the unit cube: their sizes, displacements, and the tile of a point (the plain numpy form)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FloatArray
from rtagent.features.coder import parts_of
from rtagent.features.normalise import positions

Displacement = Literal["asymmetric", "uniform"]
Tiles = NDArray[np.int64]
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


class Layer:
    """The tilings of one resolution over the signals that are known, whose tiles are numbered from `start`.

    `places` are its signals, `counts` the tiles per unit along each, `spans` the tiles that there are, `strides`
    from one to the next, `wraps` whether it has no ends, `offsets`, shape (tilings, signals), in tiles; `each`
    is how many tiles a tiling has. Raises `SpecError` for what cannot be.
    """

    def __init__(self, spec: Tilings, known: Sequence[str], start: int) -> None:
        chosen = spec.signals or tuple(known)
        self.places = positions(chosen, known, "signals")
        positions(spec.wrap, chosen, "wrap")
        self.tilings, self.start = spec.tilings, start
        counts = [parts_of(name, spec.tiles, "tiles") for name in chosen]
        if spec.tilings < 1:
            raise SpecError(f"tilings is {spec.tilings}: give at least 1.")
        self.counts: FloatArray = np.array(counts, dtype=np.float64)
        self.wraps = np.array([name in spec.wrap for name in chosen])
        spans = [count if name in spec.wrap else count + 1 for name, count in zip(chosen, counts, strict=True)]
        self.each = math.prod(spans)
        if start + self.size >= LARGEST:
            raise SpecError(f"the layers have over {LARGEST} tiles, more than can be numbered: use fewer signals.")
        self.spans = np.array(spans, dtype=np.int64)
        self.strides = np.array([math.prod(spans[place + 1 :]) for place in range(len(spans))], dtype=np.int64)
        self.offsets = _offsets(spec.tilings, len(chosen), spec.displacement)

    @property
    def size(self) -> int:
        """How many tiles it has."""
        return self.each * self.tilings

    def __call__(self, unit: FloatArray) -> Tiles:
        """Return the tile of each tiling at a point of the unit cube, shape (tilings,)."""
        cells = np.floor(unit[self.places] * self.counts + self.offsets).astype(np.int64)
        # the upper end of a range belongs to the last tile, whatever rounding made of it
        cells = np.where(self.wraps, cells % self.spans, np.minimum(cells, self.spans - 1))
        tiles: Tiles = cells @ self.strides + self.start + np.arange(self.tilings) * self.each
        return tiles


def _offsets(tilings: int, signals: int, displacement: Displacement) -> FloatArray:
    """Return the displacement of each tiling along each signal, in tiles, shape (tilings, signals)."""
    if displacement not in get_args(Displacement):
        raise SpecError(f"displacement is {displacement!r}: give one of {', '.join(get_args(Displacement))}.")
    along = 2 * np.arange(signals) + 1 if displacement == "asymmetric" else np.ones(signals, dtype=np.int64)
    steps = np.outer(np.arange(tilings), along) % tilings
    offsets: FloatArray = steps / tilings
    return offsets
