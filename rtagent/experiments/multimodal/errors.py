"""Root squared errors by input setting and finger, one entry a seed, and statistics of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from rtagent.experiments.statistics import Interval, interval

ALL, OTHERS = "All", ("Color only", "Position only")
KEPT = {
    "mean": "mean",
    "median": "median",
    "variance": "variance",
    "before": "mean before the grasp",
    "during": "mean during it",
}

Errors = Mapping[tuple[str, str], Sequence[Mapping[str, Any] | None]]
"""What `Test.errors` kept, for each seed; None where learning diverged."""
OfSeed = Callable[[str, str, str], float]
"""Returns a number of one seed's errors, by input setting, finger and name."""


def diverged(errors: Errors) -> list[str]:
    """Return the input settings with which learning diverged, for any seed and finger."""
    return sorted({setting for (setting, _), several in errors.items() if None in several})


def over_seeds(errors: Errors, statistic: Callable[[OfSeed], float]) -> Interval:
    """Return a statistic of each seed's errors, in the mean over seeds with its interval."""
    seeds = range(len(next(iter(errors.values()))))
    return interval([statistic(_of_seed(errors, seed)) for seed in seeds])


def number(errors: Errors, name: str, of: tuple[str, str]) -> Interval:
    """Return a number of one setting and finger."""
    return over_seeds(errors, lambda each: each(*of, name))


def ratio(errors: Errors, name: str, ours: tuple[str, str], others: tuple[str, str]) -> Interval:
    """Return how many times a number of one setting and finger is that of another."""
    return over_seeds(errors, lambda each: each(*ours, name) / each(*others, name))


def effect(errors: Errors, finger: str, other: str) -> Interval:
    """Return Cohen's d of another setting's errors against those of "All": positive where "All" errs less."""
    return over_seeds(errors, lambda each: _cohens_d(each, (ALL, finger), (other, finger)))


def _cohens_d(each: OfSeed, ours: tuple[str, str], others: tuple[str, str]) -> float:
    """Return how many pooled standard deviations the means lie apart (Cohen, 1988)."""
    a, b = each(*ours, "count") - 1, each(*others, "count") - 1
    pooled = np.sqrt((a * each(*ours, "variance") + b * each(*others, "variance")) / (a + b))
    return float((each(*others, "mean") - each(*ours, "mean")) / pooled)


def _of_seed(errors: Errors, seed: int) -> OfSeed:
    def named(setting: str, finger: str, name: str) -> float:
        kept: Any = errors[setting, finger][seed]
        return float(kept["quantiles"][len(kept["quantiles"]) // 2] if name == "median" else kept[name])

    return named
