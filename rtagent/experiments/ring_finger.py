"""The ring finger's return, predicted by selective Kanerva coding from hand and camera (thesis, chapter 6).

All of chapter 6 is done on the grasping stream of chapter 5: the same four signals with their traces, α, γ, λ, and
80 % of the stream to learn from. What counts is the mean squared error over the rest, in which nothing is learned.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rtagent import kernels
from rtagent.experience import FloatArray
from rtagent.experiments.chunks import follow_chunks
from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.grasping import ALPHA, FINGERS, GAMMA, LAMBDA, TRAINED, TRIALS, grasping, inputs
from rtagent.experiments.statistics import Interval, compared
from rtagent.experiments.streams import Lesson, Returns, part_error, returns, step_time
from rtagent.features import SelectiveKanerva
from rtagent.learning import TrueOnlineTD
from rtagent.learning.traces import WORTH_COMPILING
from rtagent.specs import Spec

FINGER = FINGERS["ring"]
READINGS = {"α": False, "α / c": True}
"""How α = 0.01 is read: as the step size of each weight, or as that of all c active features together."""
SEEDS, QUICK_SEEDS = 40, 3
QUICKLY = 25
"""Of the stream's 750 rows a second, in haste every so manieth is taken; γ, λ and traces are for the same time."""
TIMED, SLOWLY_TIMED = 2000, 100
LEAST_SPREAD, WIDEST = 1e-9, 1000.0
"""Spreads are not less, nor their ratios more: of few seeds, samples may have each the same."""


class Problem(NamedTuple):
    """What is learned from what, and how: `until` is the first row of the test."""

    states: FloatArray
    state: Mapping[str, Spec]
    signal: FloatArray
    truth: Returns
    gamma: float
    lambda_: float
    until: int
    told: str


@lru_cache(maxsize=2)
def problem(every: int) -> Problem:
    """Return the problem on every so manieth row of the stream."""
    stream, names = grasping(TRIALS, 0), inputs("All")
    states, signal, last = stream.states(names)[::every], stream.unit(FINGER)[::every], stream.last[::every].copy()
    last[-1] = True
    gamma = GAMMA**every
    told = f"{stream.told}, every {every}th of them" if every > 1 else stream.told
    truth = returns(signal, last, gamma)
    until = round(TRAINED * len(signal))
    return Problem(states, stream.state(names), signal, truth, gamma, LAMBDA**every, until, told)


def coder_of(cell: Cell, given: Problem) -> SelectiveKanerva:
    """Return the coder that a cell describes."""
    eta = tuple(cell["etas"])
    made = {"prototypes": cell["prototypes"], "sets": cell["sets"], "seed": cell["seed"]}
    return SelectiveKanerva(state=given.state, eta=eta, **made)


def error_of(cell: Cell) -> Row:
    """Return the mean squared errors of a cell, for each reading of α; None where learning diverged."""
    given = problem(cell["every"])
    coder = coder_of(cell, given)
    learners = {reading: _learner(coder, given, reading) for reading in READINGS}
    cumulants = dict.fromkeys(READINGS, (1.0 - given.gamma) * given.signal)
    predicted = follow_chunks(given.states, coder, learners, cumulants, given.until)
    tested = slice(given.until, None)
    errors = {reading: part_error(each, given.truth, tested, power=2) for reading, each in predicted.items()}
    plain = {reading: error if np.isfinite(error) else None for reading, error in errors.items()}
    return plain | {"active": coder.active, "told": given.told}


def time_of(cell: Cell) -> Row:
    """Return how long (s) a step takes, encoding and learning, in the plain numpy form or the compiled one."""
    given = problem(cell["every"])
    lesson = Lesson(given.states, given.signal, np.zeros(len(given.signal), np.bool_), given.gamma)
    if not cell["plain"]:
        coder = coder_of(cell, given)
        return {"step": step_time(lesson, coder, _learner(coder, given, "α / c"), TIMED), "told": given.told}
    with kernels.plain():
        coder = coder_of(cell, given)
        return {"step": step_time(lesson, coder, _learner(coder, given, "α / c"), SLOWLY_TIMED), "told": given.told}


def _learner(coder: SelectiveKanerva, given: Problem, reading: str) -> TrueOnlineTD:
    size = max(coder.size, WORTH_COMPILING)  # a smaller learner would not be compiled
    alpha = ALPHA / coder.active if READINGS[reading] else ALPHA
    step: dict[str, Any] = {"alpha": alpha, "divide_alpha": False}
    return TrueOnlineTD(size=size, active=coder.active, **step, gamma=given.gamma, lambda_=given.lambda_)


def cell_of(prototypes: int, etas: Sequence[float], seed: int, every: int, sets: int = 1, **further: Any) -> Cell:
    """Return a cell with one set of prototypes or several, and one η or several."""
    common = {"prototypes": prototypes, "etas": list(etas), "sets": sets, "seed": seed, "every": every}
    return {"kind": "error", **common, **further}


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
    """Return how many times the standard deviation over seeds, by the mean, is that of others, with its interval."""
    return compared(ours.tolist(), others.tolist(), lambda one, other: one / max(other, one / WIDEST), _spread)


def _spread(errors: FloatArray) -> np.float64:
    found: np.float64 = np.float64(max(errors.std(ddof=1) / errors.mean(), LEAST_SPREAD))
    return found
