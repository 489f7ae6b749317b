"""What it takes to decide, and to learn, which component comes next: of the quickest of many batches.

The experiment learned-ordering charges 50 µs for a decision under the virtual clock: it must not be more than that.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from timeit import repeat

import numpy as np
from _harness import Row, main

from rtagent import ms
from rtagent.orderer import Orderer
from rtagent.ordering import Gauge, Ordering

CHARGED = 50.0
DECISIONS, BATCHES = 500, 40


@dataclass
class Around:
    """Surroundings that change with every decision."""

    time: int
    observed_at: int
    queue_length: int
    reward: float
    urgency: Sequence[float]
    fresh: bool
    change: bool
    news: bool
    observable: bool
    action_pending: bool = False
    has_observed: bool = True


def surroundings() -> list[Around]:
    """Return a thousand of them, drawn at random."""
    rng = np.random.default_rng(0)
    flags = rng.random((1000, 4)) < 0.5
    return [
        Around(number * ms, number * ms - ms, number % 7, float(number), (number % 4, number % 2), *flag)
        for number, flag in enumerate(flags.tolist(), 10)
    ]


def rows() -> Iterator[Row]:
    """Time decisions in the bins of scenarios/phases.toml."""
    gauges = (Gauge(bounds=(1.0, 3.0)), Gauge(bounds=(0.5,)))
    orderer = Orderer(Ordering(urgency=gauges, queue=(1, 2, 4)), np.random.default_rng(0))
    orderer.begin(0)
    following = cycle(surroundings())
    times = repeat(lambda: orderer.decide(next(following)), number=DECISIONS, repeat=BATCHES)
    yield Row("a decision, learned from too", 1e6 * min(times) / DECISIONS, "µs", CHARGED)


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
