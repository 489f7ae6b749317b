"""Prototypes: where they are, how far from a point, and which are the nearest (the plain numpy forms)."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from rtagent import memory
from rtagent.errors import SpecError
from rtagent.experience import FloatArray, IndexArray

Distance = Literal["euclidean", "city_block", "max"]

_ADD: dict[Distance, Callable[[FloatArray, FloatArray], FloatArray]] = {
    "euclidean": lambda total, side: total + side * side,
    "city_block": np.add,
    "max": np.maximum,
}


def metric(distance: Distance) -> int:
    """Return the number of a distance among all; raise `SpecError` where it is none."""
    known = get_args(Distance)
    if distance not in known:
        raise SpecError(f"distance is {distance!r}: give one of {', '.join(known)}.")
    return known.index(distance)


def distances(prototypes: FloatArray, point: FloatArray, distance: Distance) -> FloatArray:
    """Return the distances of a point, shape (K,); those of the Euclidean metric squared.

    They are summed signal by signal, so that compiled kernels find the same to the last bit.
    """
    total = np.zeros(len(prototypes))
    for column, value in zip(prototypes.T, point, strict=True):
        total = _ADD[distance](total, np.abs(column - value))
    return total


def lengths(measured: FloatArray, distance: Distance) -> FloatArray:
    """Return proper distances from measured ones."""
    return np.sqrt(measured) if distance == "euclidean" else measured


def limit(radius: float, distance: Distance) -> float:
    """Return what a measured distance has to be below to be within a radius."""
    return radius * radius if distance == "euclidean" else radius


def smallest(measured: FloatArray, count: int) -> IndexArray:
    """Return where the `count` smallest distances stand, in rising order of place; ties to the lower place."""
    if count >= len(measured):
        return np.arange(len(measured))
    threshold = np.partition(measured, count - 1)[count - 1]
    below = np.flatnonzero(measured < threshold)
    ties = np.flatnonzero(measured == threshold)[: count - len(below)]
    return np.sort(np.concatenate((below, ties)))


def placed(prototypes: int | ArrayLike, signals: int, seed: int) -> FloatArray:
    """Return prototypes in the unit cube, shape (K, signals): drawn uniformly, or those that are given.

    Raises `SpecError` for fewer than 2, for another shape, for one outside the unit cube or not a number.
    """
    if isinstance(prototypes, Integral):
        return _drawn(int(prototypes), signals, seed)
    given = np.array(prototypes, dtype=np.float64, order="C")
    if given.ndim != 2 or given.shape[1] != signals or len(given) < 2:
        raise SpecError(f"the prototypes have shape {given.shape}: give (2 or more, {signals}).")
    if not np.all((given >= 0) & (given <= 1)):
        raise SpecError("a prototype lies outside the unit cube: normalise it by the declared ranges.")
    memory.claim(given.nbytes, "prototypes")
    return given


def _drawn(count: int, signals: int, seed: int) -> FloatArray:
    if count < 2:
        raise SpecError(f"prototypes is {count}: give at least 2.")
    memory.claim(8 * count * signals, "prototypes")
    return np.random.default_rng(seed).random((count, signals))
