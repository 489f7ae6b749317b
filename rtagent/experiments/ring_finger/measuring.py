"""What the experiments of chapter 6 measure, by one function: what they have in common is measured once."""

from __future__ import annotations

import numpy as np

from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.ring_finger.problem import error_of, time_of

POINTS = 200
"""Of figure 6.2: the thesis's own."""


def measure(cell: Cell) -> Row:
    """Measure a cell, of its kind."""
    return {"error": error_of, "time": time_of, "distance": distance_of}[cell["kind"]](cell)


def distance_of(cell: Cell) -> Row:
    """Return the distances from random points of the unit cube to their nearest prototypes, a list a seed."""
    return {"distances": [_nearest(cell["dimensions"], cell["prototypes"], seed) for seed in cell["seeds"]]}


def _nearest(dimensions: int, prototypes: int, seed: int) -> list[float]:
    rng = np.random.default_rng(seed)
    placed, points = rng.random((prototypes, dimensions)), rng.random((POINTS, dimensions))
    products = points @ placed.T
    squares = (points**2).sum(axis=1)[:, None] + (placed**2).sum(axis=1) - 2.0 * products
    nearest: list[float] = np.sqrt(np.maximum(squares.min(axis=1), 0.0)).tolist()
    return nearest
