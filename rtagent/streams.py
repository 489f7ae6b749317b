"""Random streams: one for each device, episode and policy, all derived from the seed of the run."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.random import Generator


def stream(seed: int, *names: str | int) -> Generator:
    """Return the random generator that belongs to these names; the same seed and names give the same one."""
    key = tuple(zlib.crc32(name.encode()) if isinstance(name, str) else name for name in names)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
