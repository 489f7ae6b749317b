"""The errors of each representation, gathered over streams and seeds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rtagent.experience import FloatArray
from rtagent.experiments.experiment import Cell, Row

Pair = tuple[Cell, Row]


@dataclass(frozen=True)
class Point:
    """A representation: `errors` by the reading of the step size, shape (streams, seeds), infinite after diverging.

    `size` is its number of prototypes (0: it is tile coding), `step` the median time (s) of a step.
    """

    dimensions: int
    size: int
    called: str
    features: int
    active: int
    step: float
    errors: Mapping[str, FloatArray]

    def each_stream(self, reading: str) -> FloatArray:
        """Return the error on each stream, in the mean over seeds."""
        errors: FloatArray = self.errors[reading].mean(axis=1)
        return errors

    def mean(self, reading: str) -> float:
        """Return the error in the mean over streams and seeds."""
        return float(self.errors[reading].mean())


def points(pairs: Iterable[Pair], readings: Sequence[str]) -> list[Point]:
    """Return a point for each representation of each number of dimensions, by features."""
    gathered: defaultdict[tuple[int, int, int, int], list[Pair]] = defaultdict(list)
    for cell, row in pairs:
        key = cell["dimensions"], cell.get("prototypes", 0), cell.get("tilings", 0), cell.get("tiles", 0)
        gathered[key].append((cell, row))
    made = [_point(key, several, readings) for key, several in gathered.items()]
    return sorted(made, key=lambda point: (point.dimensions, point.size > 0, point.features))


def _point(key: tuple[int, int, int, int], several: list[Pair], readings: Sequence[str]) -> Point:
    dimensions, prototypes, tilings, tiles = key
    called = f"{prototypes:,} prototypes" if prototypes else f"{tilings} tilings of {tiles} tiles a side"
    _, first = several[0]
    errors = {reading: _grid(several, reading) for reading in readings}
    step = float(np.median([row["step"] for _, row in several]))
    return Point(dimensions, prototypes, called, first["features"], first["active"], step, errors)


def _grid(several: list[Pair], reading: str) -> FloatArray:
    """Return errors by stream and seed."""
    streams = sorted({cell["stream"]["shuffle"] for cell, _ in several})
    seeds = sorted({cell["seed"] for cell, _ in several})
    grid = np.full((len(streams), len(seeds)), np.inf)
    for cell, row in several:
        if row[reading] is not None:
            grid[streams.index(cell["stream"]["shuffle"]), seeds.index(cell["seed"])] = row[reading]
    return grid
