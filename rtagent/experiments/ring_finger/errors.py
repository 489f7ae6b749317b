"""Errors by setting, one entry a seed, and how they compare."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from math import exp, log
from typing import NamedTuple

import numpy as np

from rtagent.experience import FloatArray
from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.statistics import Interval, compared

LEAST = 1e-9
"""A spread that is none."""


class Setting(NamedTuple):
    """A representation: of so many prototypes, in so many sets, with these η."""

    prototypes: int
    sets: int
    etas: tuple[float, ...]

    def __str__(self) -> str:
        sets = f"{self.sets} sets of {self.prototypes // self.sets:,}" if self.sets > 1 else f"{self.prototypes:,}"
        etas = f"η = {self.etas[0]:g}" if len(self.etas) == 1 else f"{len(self.etas)} η"
        return f"{sets} prototypes, {etas}"


Errors = Mapping[Setting, FloatArray]
"""Errors by setting, shape (seeds,): infinite where learning diverged."""


def errors_of(pairs: Iterable[tuple[Cell, Row]], reading: str) -> dict[Setting, FloatArray]:
    """Return the errors of all cells that have some, by setting."""
    gathered: defaultdict[Setting, list[float]] = defaultdict(list)
    for cell, row in pairs:
        if cell["kind"] == "error":
            setting = Setting(cell["prototypes"], cell["sets"], tuple(cell["etas"]))
            gathered[setting].append(np.inf if row[reading] is None else row[reading])
    return {setting: np.array(errors) for setting, errors in gathered.items()}


def best(errors: Errors, prototypes: int, sets: int = 1) -> Setting:
    """Return the setting with one η that errs least, in the mean over seeds."""
    own = [each for each in errors if (each.prototypes, each.sets, len(each.etas)) == (prototypes, sets, 1)]
    return min(own, key=lambda each: float(errors[each].mean()))


def ratio(ours: FloatArray, others: FloatArray) -> Interval:
    """Return the ratio of two mean errors, with its interval over seeds; infinite or 0 where one diverged."""
    if not np.isfinite(ours).all():
        return Interval(np.inf, np.inf, np.inf)
    if not np.isfinite(others).all():
        return Interval(0.0, 0.0, 0.0)
    return compared(ours.tolist(), others.tolist(), lambda one, other: one / other)


def spread_ratio(ours: FloatArray, others: FloatArray) -> Interval:
    """Return how many times the standard deviation over seeds, by the mean, is that of others, and its interval.

    It is reckoned in logarithms: samples of few seeds may have hardly any spread.
    """
    found = compared(ours.tolist(), others.tolist(), lambda one, other: log(one / other), _spread)
    return Interval(*(exp(end) for end in (found.low, found.middle, found.high)))


def _spread(errors: FloatArray) -> np.float64:
    return np.float64(max(errors.std(ddof=1) / errors.mean(), LEAST))
