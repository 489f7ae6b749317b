"""Measures cells, those that a store does not hold yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any


def compute(
    measure: Callable[[Mapping[str, Any]], Mapping[str, Any]], cells: Sequence[Mapping[str, Any]]
) -> list[Mapping[str, Any]]:
    """Return what `measure` found of each cell, in their order."""
    return [measure(cell) for cell in cells]
