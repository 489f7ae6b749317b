"""How many features can be computed within a time (thesis, table 4.1).

States are independent of each other: the worst case for selective Kanerva coding, which on a stream of similar
states asks a list of neighbours instead of all prototypes. Features are its prototypes (η 0.025, as in the thesis),
and for tile coding the tilings, so that each feature counted was computed; the thesis counts all tiles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rtagent.clock import RealClock
from rtagent.experience import FloatArray
from rtagent.features import FeatureCoder, SelectiveKanerva, TileCoding, Tilings
from rtagent.memory import available_memory
from rtagent.specs import Spec

TIME = 0.1
"""Seconds: the longest that a step of a prosthesis may take (Farrell and Weir 2007)."""
FIRST, LARGEST_QUICKLY = 200_000, 1_000_000
STATES = 11
BYTES = {"prototypes": (20, 40), "tilings": (48, 0)}
"""What a feature takes while a coder is made, which holds several copies: for each signal, and beside it."""


class Within(NamedTuple):
    """So many features fit into the time; `bounded` where it could be more, but memory, or haste, ended that."""

    features: float
    bounded: bool


def features_within(seconds: float, what: str, signals: int, seed: int, *, quick: bool = False) -> Within:
    """Return how many features of a kind are computed within a time, from coders of about that size.

    The time of one whose size is near is scaled to that asked for. None is made that would take more than a quarter
    of the free memory, or, in haste, more than a million features: that number is scaled as if time were
    proportional to it, and is not bounded then.
    """
    each, more = BYTES[what]
    bound = int((available_memory() or 4 << 30) // 4 // (each * signals + more))
    size = FIRST
    for _ in range(2):
        wanted = int(size * seconds / encoding_time(what, size, signals, seed))
        size = min(wanted, bound, LARGEST_QUICKLY if quick else wanted)
    found = size * seconds / encoding_time(what, size, signals, seed)
    return Within(float(size), True) if bound < found and not quick else Within(found, False)


def encoding_time(what: str, size: int, signals: int, seed: int) -> float:
    """Return the median time (s) of encoding one of several independent states, after a first one."""
    coder = _coder(what, size, signals, seed)
    times = [_time(coder, state) for state in np.random.default_rng(seed).random((STATES + 1, signals))]
    return float(np.median(times[1:]))


def _coder(what: str, size: int, signals: int, seed: int) -> FeatureCoder:
    state = {f"signal {number}": Spec(low=0.0, high=1.0) for number in range(signals)}
    if what == "prototypes":
        return SelectiveKanerva(state=state, prototypes=size, eta=0.025, seed=seed)
    return TileCoding(state=state, layers=(Tilings(size, 4),))


def _time(coder: FeatureCoder, state: FloatArray) -> float:
    start = RealClock.now()
    coder.encode(state)
    return (RealClock.now() - start) / 1e9
