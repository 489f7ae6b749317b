"""What chapter 6 learns: the ring finger's return, by selective Kanerva coding from hand and camera.

All of it is done on the grasping stream of chapter 5: the same four signals with their traces, α, γ, λ, and
80 % of the stream to learn from. What counts is the mean squared error over the rest, in which nothing is learned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rtagent import kernels
from rtagent.experience import FloatArray
from rtagent.experiments.chunks import follow_chunks
from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.grasping import ALPHA, FINGERS, GAMMA, LAMBDA, TRAINED, TRIALS, grasping, inputs
from rtagent.experiments.streams import Lesson, Returns, part_error, returns, step_time
from rtagent.features import SelectiveKanerva
from rtagent.learning import TrueOnlineTD
from rtagent.learning.traces import WORTH_COMPILING
from rtagent.specs import Spec

FINGER = FINGERS["ring"]
READINGS = {f"α = {ALPHA:g} of each weight": False, f"α = {ALPHA:g} / c": True}
"""How the step size is read, and whether it is divided by the number c of active features."""
DIVIDED = list(READINGS)[1]
SEEDS, QUICK_SEEDS = 40, 6
QUICKLY = 10
"""Of the stream's 750 rows a second, in haste every so manieth is taken; γ, λ and traces are for the same time."""
MODELS = ("Learned is the simulated grasping experiment of chapter 5: see there (multimodal) what it models.",)
TIMED, SLOWLY_TIMED = 2000, 100


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
        return {"step": step_time(lesson, coder, _learner(coder, given, DIVIDED), TIMED), "told": given.told}
    with kernels.plain():
        coder = coder_of(cell, given)
        return {"step": step_time(lesson, coder, _learner(coder, given, DIVIDED), SLOWLY_TIMED), "told": given.told}


def _learner(coder: SelectiveKanerva, given: Problem, reading: str) -> TrueOnlineTD:
    size = max(coder.size, WORTH_COMPILING)  # a smaller learner would not be compiled
    alpha = ALPHA / coder.active if READINGS[reading] else ALPHA
    step: dict[str, Any] = {"alpha": alpha, "divide_alpha": False}
    return TrueOnlineTD(size=size, active=coder.active, **step, gamma=given.gamma, lambda_=given.lambda_)


def cell_of(prototypes: int, etas: Sequence[float], seed: int, every: int, sets: int = 1, **further: Any) -> Cell:
    """Return a cell with one set of prototypes or several, and one η or several."""
    common = {"prototypes": prototypes, "etas": list(etas), "sets": sets, "seed": seed, "every": every}
    return {"kind": "error", **common, **further}


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    if cell["kind"] != "error":
        return 1.0
    active = int(cell["prototypes"]) * float(sum(cell["etas"]))
    each = 1.5e-6 + 1e-10 * int(cell["prototypes"]) + 13e-9 * active + 6e-7 * int(cell["sets"])
    return 0.1 + 884e3 / int(cell["every"]) * each
