"""Intervals over seeds, and verdicts that follow from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

DRAWN = 2000
LEVEL = 0.95

Statistic = Callable[[NDArray[np.float64]], np.float64]


@dataclass(frozen=True)
class Interval:
    """An estimate between the ends of its 95 % interval."""

    low: float
    middle: float
    high: float

    def __str__(self) -> str:
        return f"{self.middle:.3g} [{self.low:.3g}, {self.high:.3g}]"


def interval(values: ArrayLike, statistic: Statistic = np.mean) -> Interval:
    """Return a statistic of values, one a seed, with its bootstrap interval (percentiles of 2,000 samples)."""
    given = np.asarray(values, float)
    drawn = np.random.default_rng(0).choice(given, (DRAWN, len(given)))
    return _between(float(statistic(given)), np.array([statistic(sample) for sample in drawn]))


def compared(
    ours: Sequence[float],
    others: Sequence[float],
    how: Callable[[float, float], float],
    statistic: Statistic = np.mean,
) -> Interval:
    """Return how a statistic of one group is to that of another (a difference, a ratio), with its interval."""
    first, second = np.asarray(ours, float), np.asarray(others, float)
    rng = np.random.default_rng(0)
    pairs = [(rng.choice(first, len(first)), rng.choice(second, len(second))) for _ in range(DRAWN)]
    drawn = np.array([how(float(statistic(a)), float(statistic(b))) for a, b in pairs])
    return _between(how(float(statistic(first)), float(statistic(second))), drawn)


def _between(middle: float, drawn: NDArray[np.float64]) -> Interval:
    low, high = np.quantile(drawn, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(float(low), middle, float(high))


def cohens_d(ours: ArrayLike, others: ArrayLike) -> float:
    """Return the difference of two means in their pooled standard deviations (Cohen, 1988)."""
    first, second = np.asarray(ours, float), np.asarray(others, float)
    a, b = len(first) - 1, len(second) - 1
    pooled = np.sqrt((a * first.var(ddof=1) + b * second.var(ddof=1)) / (a + b))
    return float((first.mean() - second.mean()) / pooled)
