"""What learners predict of a stream: learned from its first part, tested on the rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

import numpy as np

from rtagent.experience import FloatArray, IndexArray

CHUNK = 8192
"""So many states are coded at once."""


class Coder(Protocol):
    """Codes successive states at once."""

    def encode_each(self, states: FloatArray, /) -> tuple[IndexArray, FloatArray | None]:
        """Return the indices of the binary features of each state, shape (n, active)."""


class Learner(Protocol):
    """Learns a stream, and predicts."""

    def follow(self, coded: IndexArray, rewards: FloatArray, /) -> FloatArray:
        """Learn from each row of features to the next; return what was predicted before."""

    def predict_each(self, coded: IndexArray, /) -> FloatArray:
        """Return the predictions for rows of features."""


def tested(
    coder: Coder,
    states: FloatArray,
    learners: Mapping[str, Learner],
    rewards: Mapping[str, FloatArray],
    trained: int,
) -> dict[str, FloatArray]:
    """Let learners learn the first `trained` transitions; return what each predicts of all later states.

    `states` has shape (n, signals); `rewards`, shape (n,) for each learner, are those of the transitions that begin
    at each state. All learn from the same features, and learn nothing in the test.
    """
    for first, last in _chunks(0, trained):
        coded, _ = coder.encode_each(states[first : last + 1])
        for name, learner in learners.items():
            learner.follow(coded, rewards[name][first:last])
    found: dict[str, list[FloatArray]] = {name: [] for name in learners}
    for first, last in _chunks(trained, len(states)):
        coded, _ = coder.encode_each(states[first:last])
        for name, learner in learners.items():
            found[name].append(learner.predict_each(coded))
    return {name: np.concatenate(parts) for name, parts in found.items()}


def _chunks(first: int, end: int) -> Iterator[tuple[int, int]]:
    return ((start, min(start + CHUNK, end)) for start in range(first, end, CHUNK))
