"""Random streams: one for each device, episode and policy, all derived from the seed of the run."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.saving import Saved


def stream(seed: int, *names: str | int) -> Generator:
    """Return the random generator that belongs to these names; the same seed and names give the same one."""
    key = tuple(zlib.crc32(name.encode()) if isinstance(name, str) else name for name in names)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def shared(rng: Generator, name: str) -> Generator:
    """Return a stream that the devices of an episode have in common: of its seed, trial and episode, and of a name.

    `rng` is the device's own stream, made by `stream` for ("device", NAME, trial, episode); it is left as it was.
    """
    seeds: Any = rng.bit_generator.seed_seq
    key = (zlib.crc32(name.encode()), *seeds.spawn_key[2:])
    return np.random.default_rng(np.random.SeedSequence(seeds.entropy, spawn_key=key))


def save_stream(rng: Generator) -> Saved:
    """Return where a generator is, and what further ones are spawned from."""
    seeds: Any = rng.bit_generator.seed_seq
    return {
        "entropy": seeds.entropy,
        "spawn_key": list(seeds.spawn_key),
        "children": seeds.n_children_spawned,
        "state": rng.bit_generator.state,
    }


def restored_stream(saved: Saved) -> Generator:
    """Return the generator that was saved; raise `SpecError` where it was of another kind than `stream` makes."""
    seeds = np.random.SeedSequence(
        saved["entropy"], spawn_key=tuple(saved["spawn_key"]), n_children_spawned=saved["children"]
    )
    rng = np.random.default_rng(seeds)
    try:
        rng.bit_generator.state = saved["state"]
    except (ValueError, KeyError, TypeError) as error:
        raise SpecError(f"the saved random state is none of {type(rng.bit_generator).__name__}: {error}.") from None
    return rng
