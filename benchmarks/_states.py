"""What the benchmarks of features and learners share: streams of states, and times of calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent import Spec

Times = NDArray[np.float64]


def cube(signals: int) -> dict[str, Spec]:
    """Return the specs of a state in the unit cube."""
    return {f"signal {number}": Spec(low=0.0, high=1.0) for number in range(signals)}


def slow_stream(count: int, signals: int, step: float = 0.005, seed: int = 0) -> NDArray[np.float64]:
    """Return a random walk in the unit cube that turns back at its faces, shape (count, signals)."""
    rng = np.random.default_rng(seed)
    walked = rng.random(signals) + np.cumsum(rng.normal(0.0, step, (count, signals)), axis=0)
    return np.abs((walked + 1.0) % 2.0 - 1.0)


def independent(count: int, signals: int, seed: int = 0) -> NDArray[np.float64]:
    """Return states drawn uniformly from the unit cube, shape (count, signals)."""
    return np.random.default_rng(seed).random((count, signals))


def times(call: Callable[[Any], object], arguments: Iterable[Any]) -> Times:
    """Return how long (µs) each call took."""
    taken = []
    for argument in arguments:
        start = time.perf_counter_ns()
        call(argument)
        taken.append(time.perf_counter_ns() - start)
    return np.array(taken) / 1e3


def in_turn(
    calls: dict[str, Callable[[Any], object]], arguments: NDArray[Any], rounds: int = 5
) -> dict[str, Times]:
    """Return how long (µs) the calls took, measured in turn so that what disturbs one disturbs all."""
    parts = np.array_split(arguments, rounds)
    for call in calls.values():
        times(call, parts[0][:50])
    measured = [{name: times(call, part) for name, call in calls.items()} for part in parts]
    return {name: np.concatenate([each[name] for each in measured]) for name in calls}
