"""Streams that are coded and learned many rows at a time, with no Python between the rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FloatArray, IndexArray, Move

Key = TypeVar("Key")

CHUNK = 8192
"""So many rows are coded at once."""


@runtime_checkable
class CodesEach(Protocol):
    """Codes successive states at once."""

    def encode_each(self, states: FloatArray) -> tuple[IndexArray, FloatArray | None]:
        """Return the features of each state: indices, shape (n, active), and values, None where all are 1."""


@runtime_checkable
class Follows(Protocol):
    """Learns a stream of binary features at once."""

    def follow(self, coded: IndexArray, rewards: FloatArray) -> FloatArray:
        """Learn from each row of features to the next; return what was predicted before."""

    def predict_each(self, coded: IndexArray) -> FloatArray:
        """Return the predictions for rows of features."""

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""


@runtime_checkable
class Adapts(Protocol):
    """A coder whose prototypes move, one in `interval` rows."""

    interval: int

    def adapt(self, state: FloatArray) -> Sequence[Move]:
        """Move a prototype to a state, if one may; return which features have become others."""


def follow_chunks(
    states: FloatArray,
    coder: CodesEach,
    learners: Mapping[Key, Follows],
    cumulants: Mapping[Key, FloatArray],
    until: int,
) -> dict[Key, FloatArray]:
    """Return what each learner predicts of each row, shape (rows,), before anything of it is learned.

    `states` has shape (rows, signals), and all learn from the features of `coder`; `cumulants`, shape (rows,) for
    each learner, are those of the transitions that begin at each row. Learning ends before the transition of row
    `until`. From where a learner diverges on, its predictions are NaN.
    """
    predictions = {name: np.full(len(states), np.nan) for name in learners}
    going, chunk = dict(learners), coder.interval if isinstance(coder, Adapts) else CHUNK
    until = min(until, len(states) - 1)
    for first, end in _chunks(0, until, chunk):
        coded = _coded(coder, states[first : end + 1])
        for name, learner in list(going.items()):
            try:
                predictions[name][first:end] = learner.follow(coded, cumulants[name][first:end])
            except SpecError:  # it has diverged
                del going[name]
        if isinstance(coder, Adapts):
            _hand_on(coder.adapt(states[end]), going)
    for first, end in _chunks(until, len(states), CHUNK):
        coded = _coded(coder, states[first:end])
        for name, learner in going.items():
            predictions[name][first:end] = learner.predict_each(coded)
    return predictions


def _coded(coder: CodesEach, states: FloatArray) -> IndexArray:
    indices, values = coder.encode_each(states)
    assert values is None, "only binary features are learned in chunks"
    return indices


def _hand_on(moves: Sequence[Move], learners: Mapping[Key, Follows]) -> None:
    for place, like in moves:
        for learner in learners.values():
            learner.inherit(place, like)


def _chunks(first: int, end: int, length: int) -> Iterator[tuple[int, int]]:
    return ((start, min(start + length, end)) for start in range(first, end, length))
