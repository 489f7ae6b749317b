"""Linear algebra with active features, and what every form of weights and traces checks of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray
from rtagent.saving import Saved, restore_fields

ALL_ONES: FloatArray = np.empty(0)
"""How kernels are told that all values are 1."""
BOUND = 1e100
"""From an error of this size on, learning diverges; weights are still finite, and so is what is made of them."""
NOTHING = FeatureVector(np.empty(0, dtype=np.intp))
"""What is active after the end."""


def check_count(name: str, number: int) -> None:
    """Raise `SpecError` unless there is at least one."""
    if number < 1:
        raise SpecError(f"{name} is {number}: give 1 or more.")


@dataclass
class Parts:
    """What is saved: weights + shift · trace are the weights, scale · trace is the trace.

    `largest` was its largest entry when scale and shift were last written into both.
    """

    weights: FloatArray
    trace: FloatArray
    scale: float = 1.0
    shift: float = 0.0
    largest: float = 0.0


def parts_saved(saved: Saved, shape: tuple[int, int]) -> Parts:
    """Return what is in a saved state of weights and trace; raise `SpecError` where they have another shape."""
    parts = Parts(np.empty(shape), np.empty(shape))
    restore_fields(parts, ("weights", "trace", "scale", "shift", "largest"), saved)
    return parts


def check_range(row: int, features: FeatureVector, rows: int, size: int) -> None:
    """Raise `SpecError` for an action or a feature that there are no weights for, or another number of values."""
    if features.values is not None and len(features.values) != len(features.indices):
        raise SpecError(f"there are {len(features.indices)} active features with {len(features.values)} values.")
    if not 0 <= row < rows:
        raise SpecError(f"there is no action {row}: this learner was made for {rows}.")
    for index in features.indices:
        if not 0 <= index < size:
            raise SpecError(f"there is no feature {index}: this learner was made with size {size}.")


def as_arrays(features: FeatureVector) -> tuple[IndexArray, FloatArray]:
    """Return indices and values as kernels take them, whatever type or layout they have."""
    values = ALL_ONES if features.values is None else np.require(features.values, np.float64, ["C", "W"])
    return np.require(features.indices, np.int64, ["C", "W"]), values


def values_of(features: FeatureVector) -> FloatArray | float:
    """Return the values of active features: 1 where they have none."""
    return 1.0 if features.values is None else features.values


def product(weights: FloatArray, features: FeatureVector) -> float:
    """Return the inner product of `weights`, shape (size,), and `features`."""
    if features.values is not None:
        with np.errstate(invalid="ignore"):  # the learner tells what is not finite
            return float(weights[features.indices] @ features.values)
    if features.indices.size == 1:
        return float(weights[features.indices[0]])
    return float(weights[features.indices].sum())


def products(weights: FloatArray, features: FeatureVector) -> FloatArray:
    """Return the inner products of every row of `weights`, shape (rows, size), and `features`."""
    if features.values is None and features.indices.size == 1:
        return weights[:, features.indices[0]].copy()
    columns = weights[:, features.indices]
    with np.errstate(invalid="ignore"):
        values: FloatArray = columns.sum(axis=1) if features.values is None else columns @ features.values
    return values
