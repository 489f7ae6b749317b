"""What predictions should have been: the returns that followed, as far as they are known yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtagent.learning.returns import TOLERANCE
from rtagent.telemetry.records import DemonAbout
from rtagent.units import second
from rtagent.view.history import History, Values

Numbers = NDArray[np.float64]


ELAPSED, TERMINATED, TRUNCATED = "elapsed (ns)", "terminated", "truncated"
"""Columns of a history of transitions, beside the signals of the next state."""

NOTHING = 1e-6
"""What weighs less than this in a return is left out."""


def returns(transitions: History, demon: DemonAbout, first: int = 0) -> Values | None:
    """Return the return after each transition from the `first` on, shape (rows,); nan where it is not known yet.

    None where it cannot be told from transitions: the cumulant is a function, or γ is.
    """
    if demon.gamma is None or demon.signal not in transitions.columns:
        return None
    columns = {
        name: transitions.column(name)[first:].astype(np.float64) for name in (ELAPSED, TERMINATED, TRUNCATED)
    }
    cumulants = _cumulants(transitions.column(demon.signal)[first:].astype(np.float64), demon)
    gammas = _discounts(columns[ELAPSED], demon.gamma, demon.per)
    if demon.normalised:
        cumulants = (1.0 - gammas) * cumulants
    return discounted(cumulants, gammas, columns[TERMINATED], columns[TRUNCATED]).astype(np.float32)


def discounted(cumulants: Numbers, gammas: Numbers, terminated: Numbers, truncated: Numbers) -> Numbers:
    """Return the discounted sum of what follows each step; all shapes (steps,), the last two 0 or 1.

    Nothing follows a step that terminated; what follows one that was truncated, or the last, is unknown, and a sum
    in which that weighs 1/1000 or more is nan. Each pass doubles how far the sums reach.
    """
    goes_on = (1.0 - terminated) * (1.0 - truncated)
    sums, weights = goes_on * _next(cumulants), goes_on * _next(gammas)
    unknown = truncated * (1.0 - terminated)
    unknown[-1:] = 1.0 - terminated[-1:]
    reach = 1
    while reach < len(sums) and weights.max() > NOTHING:
        for each in (sums, unknown):
            each[:-reach] += weights[:-reach] * each[reach:]
        weights[:-reach] *= weights[reach:]
        reach *= 2
    return np.where(unknown < TOLERANCE, sums, np.nan)


def _next(values: Numbers) -> Numbers:
    return np.append(values[1:], 0.0)


def _cumulants(values: Numbers, demon: DemonAbout) -> Numbers:
    if demon.low is None and demon.high is None:
        return values
    low = -np.inf if demon.low is None else demon.low
    high = np.inf if demon.high is None else demon.high
    return ((low <= values) & (values < high)).astype(np.float64)


def _discounts(elapsed: Numbers, gamma: float, per: str) -> Numbers:
    return np.full(len(elapsed), gamma) if per == "step" else np.power(gamma, elapsed / second)
