"""How well, and how quickly, representations predict a joint of a real arm from its other joints.

Give a recording of a Hiwonder ArmPi FPV, with the columns t, session, m1_position, m1_temperature, m1_voltage,
and so on. The base joint's position return, (1 - γ) Σ γᵏ z(t + k) with γ 0.9, is predicted from the signals of
joint 5 (position and voltage: 2 dimensions), of joints 5 and 4 (also velocity and temperature: 8), and of 5, 4
and 3 (12). Learning never stops; what counts is the mean absolute error over the last tenth, in counts, of which
the joint has 1000. Every representation with every learner has those settings, of the ones tried, that did best
over the tenth before.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from rtagent.experiments.representations.signals import ARMPI
from rtagent.experiments.streams import Lesson, Stream, follow, named, part_error, returns, step_time
from rtagent.features import FeatureCoder, SelectiveKanerva, TileCoding, Tilings
from rtagent.learning import SwiftTD, TrueOnlineTD

GAMMA, LAMBDAS = 0.9, (0.9, 0.99)
ALPHAS = (0.1, 0.3, 0.6, 1.0)
META_STEP_SIZES = (0.01, 0.1, 1.0)
SEEDS = (0, 1, 2)
SIZES = (1000, 2000, 4000, 8000)
TILES = (2, 4, 8)
COUNTS = ARMPI.ranges["position"][1]
"""Predictions are learned as fractions of the range: the step sizes of SwiftTD adapt by the size of the errors."""

Learner = TrueOnlineTD | SwiftTD


@dataclass(frozen=True)
class Score:
    """Mean absolute errors over the ninth and the tenth tenth, and the time (µs) of a step."""

    before: float
    last: float
    step: float


def lesson_of(data: Stream, dimensions: int) -> Lesson:
    """Return what is learned with so many dimensions, as a fraction of the range."""
    return Lesson(data.states(ARMPI.signals(dimensions)), data.column(ARMPI.target) / COUNTS, data.last, GAMMA)


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


def tried(lesson: Lesson, coder: FeatureCoder) -> dict[str, Score]:
    """Return, by learner, the score of the settings that did best before the last tenth."""
    truth, tenth = returns(lesson.signal, lesson.last, GAMMA), len(lesson.signal) // 10
    scores = {}
    for name, made in learners(coder).items():
        step = step_time(lesson, coder, learners(coder)[name][0]) * 1e6
        errors = [
            [COUNTS * part_error(each, truth, part) for part in (slice(-2 * tenth, -tenth), slice(-tenth, None))]
            for each in follow(lesson, coder, made)
        ]
        scores[name] = Score(*min(errors), step)
    return scores


def rows_of(data: Stream, dimensions: int, size: int) -> Iterator[tuple[str, ...]]:
    """Yield the rows of so many dimensions and features."""
    lesson, state = lesson_of(data, dimensions), data.state(ARMPI.signals(dimensions))
    seeds = [tried(lesson, SelectiveKanerva(state=state, prototypes=size, eta=0.025, seed=seed)) for seed in SEEDS]
    tilings = [tried(lesson, TileCoding(state=state, layers=(Tilings(16, tiles),), memory=size)) for tiles in TILES]
    for learner in seeds[0]:
        errors, steps = zip(*((each[learner].last, each[learner].step) for each in seeds), strict=True)
        told = f"{np.mean(errors):.1f} ± {np.std(errors):.1f}"
        yield str(dimensions), f"{size:,}", "selective Kanerva", learner, told, f"{np.median(steps):.1f}"
    for learner in tilings[0]:
        best = min((each[learner] for each in tilings), key=lambda each: each.before)
        yield str(dimensions), f"{size:,}", "tile coding", learner, f"{best.last:.1f}", f"{best.step:.1f}"


def baselines(data: Stream) -> dict[str, float]:
    """Return the errors of two predictions that learn nothing: the mean so far, and that all stays as it is."""
    signal = data.column(ARMPI.target)
    truth, tenth = returns(signal, data.last, GAMMA), slice(-(len(signal) // 10), None)
    mean = np.full(len(signal), signal[: tenth.start].mean())
    return {
        "the mean of all before": part_error(mean, truth, tenth),
        "the base joint stays where it is (which the others do not see)": part_error(signal, truth, tenth),
    }


def main() -> int:
    """Print the table, in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="numbers of features")
    options = parser.parse_args()
    data = named("recording", file=str(options.recording), signals=ARMPI.needed)
    print(f"{data.told}\n")
    for name, error in baselines(data).items():
        print(f"- {name}: {error:.1f}")
    print("\n| dimensions | features | representation | learner | error | µs a step |\n|---|---|---|---|---|---|")
    for dimensions, size in product((2, 8, 12), options.sizes):
        for row in rows_of(data, dimensions, size):
            print("| " + " | ".join(row) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
