"""Prints how many features can be computed within 100 ms, beside Table 4.1 of the thesis (a 2.5 GHz core).

What is counted, and how, `rtagent.experiments.representations.within` says. Mean and standard deviation are over
five seeds; ≥ marks what a quarter of the free memory ended.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from rtagent.experiments.representations.configurations import DIMENSIONS
from rtagent.experiments.representations.times import THESIS
from rtagent.experiments.representations.within import TIME, Within, features_within

SEEDS = 5


def told(found: Sequence[Within]) -> str:
    features = [each.features for each in found]
    bounded = "≥ " if any(each.bounded for each in found) else ""
    return f"{bounded}{np.mean(features):,.0f} ± {np.std(features, ddof=1):,.0f}"


def main() -> int:
    print(f"{'':>10}  {'tile coding':>24} {'thesis':>16}  {'selective Kanerva':>26} {'thesis':>16}")
    for signals in DIMENSIONS:
        ours = {
            what: told([features_within(TIME, what, signals, seed) for seed in range(SEEDS)])
            for what in ("tilings", "prototypes")
        }
        theirs = {what: "{:,} ± {}".format(*THESIS[what, signals]) for what in ours}
        print(
            f"{signals:>7} d.  {ours['tilings']:>24} {theirs['tilings']:>16}  "
            f"{ours['prototypes']:>26} {theirs['prototypes']:>16}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
