"""Noise that is a function of time: the same time and name always give the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

FIRST, SECOND, THIRD = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
"""The odd factors of SplitMix64 (Steele, Lea and Flood 2014)."""
MASK, BITS = (1 << 64) - 1, 24


def salt(name: str) -> int:
    """Return what keeps the noise of one name apart from that of others."""
    return sum(name.encode()) * SECOND & MASK


def salts(names: Sequence[str]) -> NDArray[np.uint64]:
    """Return those of several names, shape (names, 1)."""
    return np.array([[salt(name)] for name in names], np.uint64)


def bits(time: Any, salted: Any) -> Any:
    """Return 24 bits that look random, of a time (ns) and a salt, or of arrays of them."""
    if isinstance(time, np.ndarray):
        time = time.astype(np.uint64)
    mixed = (time * FIRST + salted) & MASK
    mixed = (mixed ^ mixed >> 29) * THIRD & MASK
    return mixed >> (64 - BITS)


def uniform(drawn: Any) -> Any:
    """Return bits as fractions, from 0 to below 1."""
    return drawn / (1 << BITS)
