"""Prints how many features can be computed within 100 ms, beside Table 4.1 of the thesis (a 2.5 GHz core).

States are independent of each other: the worst case for selective Kanerva coding, which on a stream of similar
states asks a list of neighbours instead of all prototypes. Features are its prototypes (eta 0.025, as in the
thesis), and for tile coding the tilings, so that each feature counted was computed; the thesis counts all tiles.
Each figure is from coders of about that size, scaled by what their median time differs from 100 ms; mean and
standard deviation are over five seeds. A coder is made no larger than a quarter of the free memory allows: ≥ marks
what that ended.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from _states import cube, independent, times

from rtagent.features import FeatureCoder, SelectiveKanerva, TileCoding, Tilings
from rtagent.memory import available_memory

WITHIN = 100e3
SEEDS, STATES = 5, 11
DIMENSIONS = (2, 8, 12)
THESIS = {
    2: ((247439, 302), (19333, 236)),
    8: ((244496, 534), (12960, 198)),
    12: ((245724, 620), (10883, 165)),
}

Maker = Callable[[int, int, int], FeatureCoder]


@dataclass(frozen=True)
class Figure:
    """Features within the time: mean and standard deviation, and whether memory was what ended it."""

    mean: float
    deviation: float
    bounded: bool

    def __str__(self) -> str:
        return f"{'≥ ' if self.bounded else ''}{self.mean:,.0f} ± {self.deviation:,.0f}"


def prototypes(signals: int, features: int, seed: int) -> FeatureCoder:
    return SelectiveKanerva(state=cube(signals), prototypes=features, eta=0.025, seed=seed)


def tilings(signals: int, features: int, seed: int) -> FeatureCoder:
    return TileCoding(state=cube(signals), layers=(Tilings(features, 4),))


def measured(make: Maker, signals: int, features: int, seed: int) -> float:
    """Return the median time (µs) of encoding one of several independent states."""
    coder, states = make(signals, features, seed), independent(STATES + 1, signals, seed)
    return float(np.median(times(coder.encode, states)[1:]))


def within(make: Maker, signals: int, bytes_each: int) -> Figure:
    """Return how many features are computed within the time, by coders of about that size."""
    free = available_memory() or 4 << 30
    size, bound, bounded = 200_000, free // 4 // bytes_each, False
    for _ in range(2):
        wanted = int(size * WITHIN / measured(make, signals, size, 0))
        size, bounded = min(wanted, bound), wanted > bound
    found = [size * WITHIN / measured(make, signals, size, seed) for seed in range(SEEDS)]
    if bounded:
        found = [float(size)] * SEEDS
    return Figure(float(np.mean(found)), float(np.std(found, ddof=1)), bounded)


def main() -> int:
    print(f"{'':>10}  {'tile coding':>24} {'thesis':>16}  {'selective Kanerva':>26} {'thesis':>16}")
    for signals in DIMENSIONS:
        # at their making, coders hold several copies of what they keep
        tiles, kanerva = within(tilings, signals, 48 * signals), within(prototypes, signals, 20 * signals + 40)
        (their_tiles, spread), (their_kanerva, wide) = THESIS[signals]
        print(
            f"{signals:>7} d.  {tiles!s:>24} {f'{their_tiles:,} ± {spread}':>16}  "
            f"{kanerva!s:>26} {f'{their_kanerva:,} ± {wide}':>16}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
