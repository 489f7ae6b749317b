"""How well, and how quickly, representations predict a joint of a real arm from its other joints.

Give a recording of a Hiwonder ArmPi FPV, with the columns t, session, m1_position, m1_temperature, m1_voltage,
and so on. The base joint's position return, (1 - γ) Σ γᵏ z(t + 1 + k) with γ 0.9, is predicted from the signals
of joint 5 (position and voltage: 2 dimensions), of joints 5 and 4 (also velocity and temperature: 8), and of 5,
4 and 3 (12). Learning never stops; what counts is the mean absolute error over the last tenth, in counts, of
which the joint has 1000. Every representation with every learner has those settings, of the ones tried, that
did best over the tenth before.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from rtagent import Spec
from rtagent.experience import FeatureVector, Transition
from rtagent.features import FeatureCoder, SelectiveKanerva, TileCoding, Tilings
from rtagent.learning import SwiftTD, TrueOnlineTD
from rtagent_drivers.tables import Table, read_table

TARGET, JOINTS = "m6_position", ("m5", "m4", "m3")
POSITION, VELOCITY, TEMPERATURE, VOLTAGE = (0.0, 1000.0), (-600.0, 600.0), (20.0, 70.0), (4500.0, 8500.0)
RANGES = {"position": POSITION, "velocity": VELOCITY, "temperature": TEMPERATURE, "voltage": VOLTAGE}
GAMMA, LAMBDAS = 0.9, (0.9, 0.99)
ALPHAS = (0.1, 0.3, 0.6, 1.0)
META_STEP_SIZES = (0.01, 0.1, 1.0)
SEEDS = (0, 1, 2)
SIZES = (1000, 2000, 4000, 8000)
TILES = (2, 4, 8)
COUNTS = POSITION[1]
"""Predictions are learned as fractions of the range: the step sizes of SwiftTD adapt by the size of the errors."""

UNKNOWN = 1e-3
"""The weight, in a return, of what comes after the end of a session, above which it is not compared."""

Floats = NDArray[np.float64]
Learner = TrueOnlineTD | SwiftTD


@dataclass(frozen=True)
class Stream:
    """Valid rows of a recording: the signals, the target, and whether a row is the last of its session."""

    signals: dict[str, Floats]
    target: Floats
    last: NDArray[np.bool_]


def stream(table: Table) -> Stream:
    """Take the rows whose values are all in range; velocities are differences of positions."""
    columns = [TARGET, *(f"{joint}_{kind}" for joint in JOINTS for kind in ("position", "temperature", "voltage"))]
    within = np.ones(len(table.times), dtype=bool)
    for name in columns:
        low, high = RANGES[name.split("_")[1]]
        within &= (table.columns[name] >= low) & (table.columns[name] <= high)
    sessions = np.asarray(table.sessions)[within]
    last = np.append(sessions[1:] != sessions[:-1], True)
    first = np.append(True, last[:-1])
    signals = {name: table.columns[name][within] for name in columns if name != TARGET}
    elapsed = np.maximum(np.diff(table.times[within], prepend=0.0), 1e-3)
    for joint in JOINTS:
        moved = np.diff(signals[f"{joint}_position"], prepend=0.0)
        signals[f"{joint}_velocity"] = np.where(first, 0.0, moved / elapsed)
    return Stream(signals, table.columns[TARGET][within] / COUNTS, last)


def dimensions(count: int) -> list[str]:
    """Return which signals are seen with so many dimensions."""
    if count == 2:
        return ["m5_position", "m5_voltage"]
    return [f"{joint}_{kind}" for joint in JOINTS[: count // 4] for kind in RANGES]


def returns(data: Stream) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the normalised return from each row, and whether it is known."""
    found, known = np.zeros(len(data.target)), np.zeros(len(data.target), dtype=bool)
    total, weight = 0.0, 1.0
    for row in range(len(found) - 1, -1, -1):
        if data.last[row]:
            total, weight = 0.0, 1.0
        else:
            total = (1 - GAMMA) * data.target[row + 1] + GAMMA * total
            weight *= GAMMA
        found[row], known[row] = total, weight < UNKNOWN
    return found, known


@dataclass(frozen=True)
class Score:
    """Mean absolute errors over the ninth and the tenth tenth, and the median time (µs) of a step."""

    before: float
    last: float
    step: float


def encode(coder: FeatureCoder, states: Floats) -> tuple[list[FeatureVector], float]:
    """Return the features of every state, and the median time (s) of one."""
    coded, times = [], []
    for state in states:
        start = perf_counter()
        coded.append(coder.encode(state))
        times.append(perf_counter() - start)
    return coded, float(np.median(times))


def score(data: Stream, coded: Sequence[FeatureVector], encoding: float, learner: Learner) -> Score:
    """Learn the whole stream; compare each prediction, made before its row is learned from, with its return."""
    truth, known = returns(data)
    predictions, times = np.zeros(len(truth)), []
    for row in range(len(truth) - 1):
        predictions[row] = learner.predict(coded[row])
        if data.last[row]:
            continue
        reward, truncated = (1 - GAMMA) * float(data.target[row + 1]), bool(data.last[row + 1])
        step = Transition(coded[row], None, 1.0, reward, coded[row + 1], None, 0, False, truncated)
        start = perf_counter()
        learner.update(step)
        times.append(perf_counter() - start)
    errors, tenth = COUNTS * np.abs(predictions - truth), len(truth) // 10
    before, last = (slice(-2 * tenth, -tenth), slice(-tenth, None))
    means = [float(errors[part][known[part]].mean()) for part in (before, last)]
    return Score(*means, (encoding + float(np.median(times))) * 1e6)


def learners(coder: FeatureCoder) -> dict[str, list[Learner]]:
    """Return, by name, every learner that is tried."""
    common = {"size": coder.size, "active": coder.active, "gamma": GAMMA}
    return {
        "true online TD(λ)": [
            TrueOnlineTD(alpha=alpha, lambda_=lambda_, **common)  # type: ignore[arg-type]
            for alpha, lambda_ in product(ALPHAS, LAMBDAS)
        ],
        "SwiftTD": [
            SwiftTD(alpha=alpha, lambda_=LAMBDAS[0], eta=1.0, meta_step_size=meta, **common)  # type: ignore[arg-type]
            for alpha, meta in product(ALPHAS[:3], META_STEP_SIZES)
        ],
    }


def tried(data: Stream, coder: FeatureCoder, states: Floats) -> dict[str, Score]:
    """Return, by learner, the score of the settings that did best before the last tenth."""
    coded, encoding = encode(coder, states)
    scores = {
        name: [score(data, coded, encoding, learner) for learner in made] for name, made in learners(coder).items()
    }
    return {name: min(several, key=lambda each: each.before) for name, several in scores.items()}


def rows_of(data: Stream, count: int, size: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of so many dimensions and features."""
    state = {name: Spec(low=low, high=high) for name, (low, high) in _ranges(count).items()}
    states = np.stack([data.signals[name] for name in state], axis=1)
    seeds = [
        tried(data, SelectiveKanerva(state=state, prototypes=size, eta=0.025, seed=seed), states) for seed in SEEDS
    ]
    tilings = [
        tried(data, TileCoding(state=state, layers=(Tilings(16, tiles),), memory=size), states) for tiles in TILES
    ]
    for learner in seeds[0]:
        errors, steps = zip(*((each[learner].last, each[learner].step) for each in seeds), strict=True)
        told = f"{np.mean(errors):.1f} ± {np.std(errors):.1f}"
        yield str(count), f"{size:,}", "selective Kanerva", learner, told, f"{np.median(steps):.1f}"
    for learner in tilings[0]:
        best = min((each[learner] for each in tilings), key=lambda each: each.before)
        yield str(count), f"{size:,}", "tile coding", learner, f"{best.last:.1f}", f"{best.step:.1f}"


def _ranges(count: int) -> dict[str, tuple[float, float]]:
    return {name: RANGES[name.split("_")[1]] for name in dimensions(count)}


def baselines(data: Stream) -> dict[str, float]:
    """Return the errors of two predictions that learn nothing: the mean so far, and that all stays as it is."""
    truth, known = returns(data)
    tenth = slice(-(len(truth) // 10), None)
    mean = truth[known][: -len(truth) // 10].mean()
    return {
        "the mean of all before": COUNTS * float(np.abs(truth[tenth] - mean)[known[tenth]].mean()),
        "the base joint stays where it is (which the others do not see)": COUNTS
        * float(np.abs(truth[tenth] - data.target[tenth])[known[tenth]].mean()),
    }


def main() -> int:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of features")
    options = parser.parse_args()
    data = stream(read_table(options.recording))
    print(f"{len(data.target):,} rows, {int(data.last.sum())} sessions\n")
    for name, error in baselines(data).items():
        print(f"- {name}: {error:.1f}")
    print("\n| dimensions | features | representation | learner | error | µs a step |\n|---|---|---|---|---|---|")
    for count, size in product((2, 8, 12), options.sizes):
        for row in rows_of(data, count, size):
            print("| " + " | ".join(row) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
