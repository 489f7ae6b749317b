"""Noise that is a function of time: the same time and name always give the same."""

from __future__ import annotations

from typing import Any

import numpy as np

FIRST, SECOND, THIRD = 0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB
"""The odd factors of SplitMix64 (Steele, Lea and Flood 2014)."""
MASK, BITS = (1 << 64) - 1, 24


def bits(time: Any, name: str) -> Any:
    """Return 24 bits that look random, of a time (ns), or of each in an array."""
    if isinstance(time, np.ndarray):
        time = time.astype(np.uint64)
    mixed = (time * FIRST + (sum(name.encode()) * SECOND & MASK)) & MASK
    mixed = (mixed ^ mixed >> 29) * THIRD & MASK
    return mixed >> (64 - BITS)


def uniform(drawn: Any) -> Any:
    """Return bits as fractions, from 0 to below 1."""
    return drawn / (1 << BITS)
