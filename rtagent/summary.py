"""Summaries of series: count, median, p90, p99, maximum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Summary:
    """Quantiles of some times, in ns (0 where there are none), and how many were missed."""

    count: int
    median: float
    p90: float
    p99: float
    maximum: float
    missed: int = 0

    @classmethod
    def of(
        cls, values: Sequence[int], *, count: int | None = None, maximum: int | None = None, missed: int = 0
    ) -> Summary:
        """Summarise `values` (ns); `count` and `maximum` where more were seen than kept."""
        if not values:
            return cls(0, 0.0, 0.0, 0.0, 0.0, missed)
        median, p90, p99 = (float(q) for q in np.quantile(np.asarray(values), (0.5, 0.9, 0.99)))
        return cls(
            len(values) if count is None else count,
            median,
            p90,
            p99,
            float(max(values) if maximum is None else maximum),
            missed,
        )

    def in_seconds(self) -> dict[str, float | int]:
        """Return the summary as results write it."""
        return {
            "count": self.count,
            "median_s": self.median / 1e9,
            "p90_s": self.p90 / 1e9,
            "p99_s": self.p99 / 1e9,
            "max_s": self.maximum / 1e9,
        }
