"""Streams of signals, and how well their returns are predicted: representation, true online TD(λ), errors.

A stream comes by its name from the plug-ins `rtagent.streams`: anything callable whose keywords are its settings,
and which returns a `Stream`. Returns are normalised, (1 - γ) Σ γᵏ z(t + k), the present signal included, and so are
the cumulants that learn them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent import plugins
from rtagent.clock import RealClock
from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import FloatArray, Transition
from rtagent.features import FeatureCoder
from rtagent.learning import PredictionLearner
from rtagent.specs import Spec

BoolArray = NDArray[np.bool_]
UNKNOWN = 1e-3
"""The weight, in a return, of what comes after the end of a session, above which it is not compared."""
TIMED, PARTS = 2000, 10
"""So many rows are timed, in so many parts."""


@dataclass(frozen=True)
class Stream:
    """Signals over time: `columns` by name, shape (rows,), and the `ranges` (low, high) that normalise them.

    `last`, shape (rows,), says which rows are the last of a session, across whose end nothing is learned; `rate` is
    in Hz, 0 where rows are not evenly spaced; `told` says what it is, for captions.
    """

    columns: Mapping[str, FloatArray]
    ranges: Mapping[str, tuple[float, float]]
    last: BoolArray
    rate: float
    told: str

    def __len__(self) -> int:
        """Return how many rows there are."""
        return len(self.last)

    def column(self, name: str) -> FloatArray:
        """Return a signal, shape (rows,); raise `SpecError` where it has none of that name."""
        if name not in self.columns:
            raise SpecError(f"{self.told} has no signal {name!r}{did_you_mean(name, list(self.columns))}")
        return self.columns[name]

    def state(self, names: Sequence[str]) -> dict[str, Spec]:
        """Return the specs of these signals, as feature coders take them."""
        return {name: Spec(low=self.ranges[name][0], high=self.ranges[name][1]) for name in names}

    def states(self, names: Sequence[str]) -> FloatArray:
        """Return the values of these signals, shape (rows, signals)."""
        return np.stack([self.column(name) for name in names], axis=1)

    def unit(self, name: str) -> FloatArray:
        """Return a signal as a fraction of its range, shape (rows,); what lies outside is clipped."""
        low, high = self.ranges[name]
        unit: FloatArray = np.clip((self.column(name) - low) / (high - low), 0.0, 1.0)
        return unit

    def traced(self, names: Sequence[str], decay: float) -> Stream:
        """Return the stream with a trace of each of these signals beside it, called `NAME_trace`, normalised.

        A trace is T ← decay · T + (1 - decay) · S of the normalised signal, from 0 at the start of each session.
        """
        traces = {f"{name}_trace": self._trace(name, decay) for name in names}
        ranges = dict.fromkeys(traces, (0.0, 1.0))
        return replace(self, columns={**self.columns, **traces}, ranges={**self.ranges, **ranges})

    def _trace(self, name: str, decay: float) -> FloatArray:
        total, traced = 0.0, []
        for value, last in zip(self.unit(name).tolist(), self.last.tolist(), strict=True):
            total = decay * total + (1.0 - decay) * value
            traced.append(total)
            total = 0.0 if last else total
        return np.array(traced)


def named(name: str, **settings: Any) -> Stream:
    """Return the stream of that name; raise `PluginError` with the nearest names where there is none."""
    made: Stream = plugins.load("streams", name)(**settings)
    return made


def seen_ranges(columns: Mapping[str, FloatArray]) -> dict[str, tuple[float, float]]:
    """Return the least and the greatest value of each column; of a constant one, a range of 1 around it."""
    ends = {name: (float(values.min()), float(values.max())) for name, values in columns.items()}
    return {name: (low, high) if low < high else (low - 0.5, high + 0.5) for name, (low, high) in ends.items()}


class Returns(NamedTuple):
    """The return from each row, shape (rows,), and whether it is known: what is left of it weighs nothing."""

    values: FloatArray
    known: BoolArray


def returns(signal: FloatArray, last: BoolArray, gamma: float) -> Returns:
    """Return (1 - γ) Σ γᵏ z(t + k) from each row, to the end of its session, and from there as if z stayed."""
    found, known = [], []
    total, weight = 0.0, 1.0
    for value, ends in zip(signal[::-1].tolist(), last[::-1].tolist(), strict=True):
        if ends:
            total, weight = value, 1.0
        total = (1.0 - gamma) * value + gamma * total
        weight *= gamma
        found.append(total)
        known.append(weight < UNKNOWN)
    return Returns(np.array(found[::-1]), np.array(known[::-1]))


@dataclass(frozen=True)
class Lesson:
    """What is learned: from which `states`, shape (rows, signals), the return of which `signal` at which γ.

    Learning ends before row `until` (0: never); predictions go on.
    """

    states: FloatArray
    signal: FloatArray
    last: BoolArray
    gamma: float
    until: int = 0


def follow(lesson: Lesson, coder: FeatureCoder, learners: Sequence[PredictionLearner]) -> FloatArray:
    """Return what each learner predicts, shape (learners, rows), each row before anything of it is learned.

    From where a learner diverges on, its predictions are NaN.
    """
    rows, cumulants = len(lesson.states), ((1.0 - lesson.gamma) * lesson.signal).tolist()
    last, until = lesson.last.tolist(), lesson.until or rows
    predictions = np.full((len(learners), rows), nan)
    going = dict(enumerate(learners))
    features = coder.encode(lesson.states[0])
    for row in range(rows):
        for number, learner in going.items():
            predictions[number, row] = learner.predict(features)
        if row + 1 == rows:
            break
        following = coder.encode(lesson.states[row + 1])
        if row < until and not last[row]:
            step = Transition(features, None, 1.0, cumulants[row], following, None, 0, False, last[row + 1])
            going = {number: each for number, each in going.items() if _learned(each, step)}
        features = following
    return predictions


def _learned(learner: PredictionLearner, step: Transition) -> bool:
    """Return whether a step could be learned: not where learning diverges."""
    try:
        learner.update(step)
    except SpecError:
        return False
    return True


def step_time(lesson: Lesson, coder: FeatureCoder, learner: PredictionLearner, rows: int = TIMED) -> float:
    """Return how long (s) a step takes, encoding and learning, in the mean over a part of the first rows.

    Of ten parts it is the quickest: other programs may have disturbed the rest.
    """
    count = min(rows, len(lesson.states))
    edges = np.linspace(0, count, PARTS + 1).astype(int)
    times = [_mean_time(lesson, coder, learner, slice(first, end)) for first, end in pairwise(edges)]
    return min(times)


def _mean_time(lesson: Lesson, coder: FeatureCoder, learner: PredictionLearner, rows: slice) -> float:
    some = Lesson(lesson.states[rows], lesson.signal[rows], lesson.last[rows], lesson.gamma)
    start = RealClock.now()
    follow(some, coder, [learner])
    return (RealClock.now() - start) / 1e9 / len(some.states)


def part_error(predictions: FloatArray, truth: Returns, part: slice, power: int = 1) -> float:
    """Return the mean of |error|^`power` over the rows of a part whose return is known; NaN after diverging.

    Raises `SpecError` where there are none.
    """
    errors = np.abs(predictions[part] - truth.values[part])[truth.known[part]]
    if not errors.size:
        raise SpecError("the stream is too short: no return is known in the part of it that errors are taken from.")
    return float(np.mean(errors**power))
