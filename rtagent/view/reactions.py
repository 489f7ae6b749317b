"""Reaction times as a histogram whose bins grow with the time: a tenth of a decade each."""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import Any

import numpy as np

from rtagent.telemetry.records import Reaction

BINS_A_DECADE = 10
PARTS = ("reaction", "sensing", "deciding", "acting")
MOST_KEPT = 10_000
"""Quantiles are of so many of the newest."""


class Reactions:
    """Counts of all reaction times, and the quantiles of the newest."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._newest: deque[tuple[int, ...]] = deque(maxlen=MOST_KEPT)
        self.count = 0

    def add(self, reaction: Reaction) -> None:
        """Count a reaction."""
        self.count += 1
        self._counts[math.floor(BINS_A_DECADE * math.log10(max(1, reaction.reaction)))] += 1
        self._newest.append(tuple(getattr(reaction, part) for part in PARTS))

    def told(self) -> dict[str, Any]:
        """Return the bins (lower edges, in µs), their counts, and the median and p99 (µs) of each part."""
        if not self._counts:
            return {"count": 0}
        bins = range(min(self._counts) - 1, max(self._counts) + 3)
        quantiles = np.percentile(np.array(self._newest) / 1000, (50, 99, 100), axis=0).T
        return {
            "count": self.count,
            "edges": [10 ** (place / BINS_A_DECADE) / 1000 for place in bins],
            "counts": [self._counts[place] for place in bins],
            "parts": {part: row.tolist() for part, row in zip(PARTS, quantiles, strict=True)},
        }
