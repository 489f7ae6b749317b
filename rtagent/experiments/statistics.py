"""Intervals over seeds, and verdicts that follow from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rtagent.experiments.experiment import Verdict

DRAWN = 2000
LEVEL = 0.95
FEW = 2
"""Of fewer seeds nothing is known but their own values: the interval has no ends."""
NORMAL = 1.959964
STUDENT = (12.7062, 4.3027, 3.1824, 2.7764, 2.5706, 2.4469, 2.3646, 2.3060, 2.2622)
"""The 97.5 % quantiles of the normal distribution, and of Student's t with 1 to 9 degrees of freedom."""

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
    return _between(float(statistic(given)), _drawn(given, statistic, np.random.default_rng(0)), len(given))


def compared(
    ours: Sequence[float],
    others: Sequence[float],
    how: Callable[[float, float], float],
    statistic: Statistic = np.mean,
) -> Interval:
    """Return how a statistic of one group is to that of another (a difference, a ratio), with its interval."""
    first, second = np.asarray(ours, float), np.asarray(others, float)
    rng = np.random.default_rng(0)
    pairs = zip(_drawn(first, statistic, rng), _drawn(second, statistic, rng), strict=True)
    drawn = np.array([how(float(a), float(b)) for a, b in pairs])
    return _between(how(float(statistic(first)), float(statistic(second))), drawn, min(len(first), len(second)))


def _drawn(given: NDArray[np.float64], statistic: Statistic, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a statistic of samples that are drawn from values, with replacement."""
    samples = rng.choice(given, (DRAWN, len(given)))
    if statistic in (np.mean, np.median):
        found: NDArray[np.float64] = np.asarray(statistic(samples, axis=1))
        return found
    return np.array([statistic(sample) for sample in samples])


def paired(ours: ArrayLike, others: ArrayLike, statistic: Statistic = np.mean) -> Interval:
    """Return a statistic of the differences, seed by seed, of two groups that met the same worlds."""
    return interval(np.subtract(ours, others), statistic)


def pooled(
    pairs: Sequence[tuple[Sequence[float], Sequence[float]]],
    how: Callable[[NDArray[np.float64], NDArray[np.float64]], float],
) -> Interval:
    """Return how one group is to the other in the mean over several pairs of groups, with its interval."""
    given = [(np.asarray(first, float), np.asarray(second, float)) for first, second in pairs]
    rng = np.random.default_rng(0)
    drawn = [np.mean([how(rng.choice(a, len(a)), rng.choice(b, len(b))) for a, b in given]) for _ in range(DRAWN)]
    return _between(
        float(np.mean([how(a, b) for a, b in given])), np.array(drawn), min(min(len(a), len(b)) for a, b in given)
    )


def _between(middle: float, drawn: NDArray[np.float64], seeds: int) -> Interval:
    """Return the percentiles of what was drawn, widened as few seeds ask for (expanded: Hesterberg, 2015).

    Samples with replacement vary less than the seeds do, by (n - 1) / n, and their quantiles are normal ones where
    Student's are due.
    """
    if seeds < FEW:
        return Interval(-np.inf, middle, np.inf)
    ends = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)
    low, high = np.quantile(drawn, ends, method="inverted_cdf")  # which takes ratios to nothing, too
    wider = np.sqrt(seeds / (seeds - 1)) * _student(seeds - 1) / NORMAL
    return Interval(float(middle - wider * (middle - low)), middle, float(middle + wider * (high - middle)))


def _student(freedom: int) -> float:
    """Return the 97.5 % quantile of Student's t: from the table, beyond it by Cornish and Fisher's series."""
    if freedom <= len(STUDENT):
        return STUDENT[freedom - 1]
    z = NORMAL
    first, second = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96
    return z + first / freedom + second / freedom**2


def cohens_d(ours: ArrayLike, others: ArrayLike) -> float:
    """Return the difference of two means in their pooled standard deviations (Cohen, 1988)."""
    first, second = np.asarray(ours, float), np.asarray(others, float)
    a, b = len(first) - 1, len(second) - 1
    pooled = np.sqrt((a * first.var(ddof=1) + b * second.var(ddof=1)) / (a + b))
    return float((first.mean() - second.mean()) / pooled)


def within(found: Interval, low: float, high: float) -> Verdict:
    """Return whether all of an interval lies from `low` to `high`, or nothing of it; undecided where some does."""
    if low <= found.low and found.high <= high:
        return Verdict.REPRODUCED
    outside = found.high < low or found.low > high
    return Verdict.NOT_REPRODUCED if outside else Verdict.UNDECIDED


def above(found: Interval, bound: float = 0.0) -> Verdict:
    """Return whether all of an interval lies above a bound, or nothing of it; undecided where some does."""
    if found.low > bound:
        return Verdict.REPRODUCED
    return Verdict.NOT_REPRODUCED if found.high <= bound else Verdict.UNDECIDED


def below(found: Interval, bound: float = 0.0) -> Verdict:
    """Return whether all of an interval lies below a bound, or nothing of it; undecided where some does."""
    return above(Interval(-found.high, -found.middle, -found.low), -bound)


def all_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict on a claim of which each is a part: reproduced where all are."""
    given = set(verdicts)
    order = (Verdict.NOT_REPRODUCED, Verdict.UNDECIDED, Verdict.DIFFERS)
    return next((verdict for verdict in order if verdict in given), Verdict.REPRODUCED)
