"""Several η on one set of prototypes (thesis, section 6.2.2, figure 6.7)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.eta import ETAS, seconds
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Verdict
from rtagent.experiments.ring_finger import (
    QUICK_SEEDS,
    QUICKLY,
    READINGS,
    SEEDS,
    Errors,
    Setting,
    best,
    cell_of,
    error_of,
    errors_of,
    ratio,
    spread_ratio,
)
from rtagent.experiments.statistics import Interval, above, below, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

SIZES = (500, 4000, 8000)
QUICK_ETAS = (0.0025, 0.01, 0.025)
SIXTEEN = tuple(float(eta) for eta in np.linspace(0.0025, 0.075, 16).round(6))
TWO = (0.05, 0.1)
"""The pair that the thesis names for 4,000 prototypes."""
LITTLE = (0.9, 1.1)
"""Ratios of errors that are little different."""

Pair = tuple[Cell, Row]


def cells(options: Options) -> list[Cell]:
    """Return the cells: one η of several sizes, two η of 4,000 prototypes, sixteen of 500."""
    etas = QUICK_ETAS if options.quick else ETAS
    seeds, every = (QUICK_SEEDS, QUICKLY) if options.quick else (SEEDS, 1)
    settings = [(size, (eta,)) for size, eta in product(SIZES, etas)] + [(4000, TWO), (500, SIXTEEN)]
    return [cell_of(size, own, seed, every) for (size, own), seed in product(settings, range(seeds))]


def measure(cell: Cell) -> Row:
    """Measure a cell."""
    return error_of(cell)


def find(pairs: Sequence[Pair], options: Options) -> Findings:
    """Return what was found."""
    by_reading = {reading: errors_of(pairs, reading) for reading in READINGS}
    claims = [claim for reading, errors in by_reading.items() for claim in _claims(errors, reading)]
    told = pairs[0][1]["told"]
    return Findings(tuple(claims), (_figure(by_reading, told),), (), (f"Learned is {told}.",))


def _claims(errors: Errors, reading: str) -> Iterator[Claim]:
    few, middle, many = (best(errors, size) for size in SIZES)
    sixteen, two = Setting(500, 1, SIXTEEN), Setting(4000, 1, TWO)
    against = f"(α = 0.01 as {reading})"
    found = ratio(errors[sixteen], errors[few])
    yield Claim(
        f"500 prototypes err less with 16 η than with the best one {against}",
        "by using 16 η values the error drops substantially",
        f"{errors[sixteen].mean():.3g}; {few} {errors[few].mean():.3g}; ratio {found}",
        below(found, 1.0),
    )
    found = ratio(errors[sixteen], errors[many])
    yield Claim(
        f"500 prototypes with 16 η are not as good as 8,000 with one {against}",
        "not as good as the performance of the original setting with 8000 prototypes and η = 0.0025",
        f"{errors[sixteen].mean():.3g}; {many} {errors[many].mean():.3g}; ratio {found}",
        above(found, 1.0),
    )
    found = ratio(errors[two], errors[middle])
    yield Claim(
        f"4,000 prototypes are little different with two η {against}",
        "little difference between the 4000 prototype settings",
        f"{errors[two].mean():.3g}; {middle} {errors[middle].mean():.3g}; ratio {found}",
        within(found, *LITTLE),
    )
    yield _varies_less(errors[two], errors[middle], against)


def _varies_less(ours: np.ndarray, others: np.ndarray, against: str) -> Claim:
    finite = np.isfinite(ours).all() and np.isfinite(others).all()
    found = spread_ratio(ours, others) if finite else Interval(np.inf, np.inf, np.inf)
    return Claim(
        f"and vary less with how prototypes are drawn {against}",
        "a small decrease in variability when using more η",
        f"standard deviation over seeds by the mean, two η to one: {found}",
        below(found, 1.0) if finite else Verdict.NOT_REPRODUCED,
    )


def _figure(by_reading: dict[str, dict[Setting, np.ndarray]], told: str) -> Figure:
    seeds = len(next(iter(next(iter(by_reading.values())).values())))
    caption = (
        f"Figure 6.7: mean squared error over the last fifth of {told}, of the best η for 500, 4,000 and 8,000 "
        f"prototypes, 4,000 with two η and 500 with 16; boxes over {seeds} seeds, α = 0.01 read both ways. "
        "What diverged is left out."
    )
    return Figure("6.7", caption, partial(_draw, by_reading), (7.5, 4.0))


def _draw(by_reading: dict[str, dict[Setting, np.ndarray]], canvas: Canvas) -> None:
    axes = canvas.subplots()
    for number, (reading, errors) in enumerate(by_reading.items()):
        settings = [*(best(errors, size) for size in SIZES), Setting(4000, 1, TWO), Setting(500, 1, SIXTEEN)]
        shown = [(place, each) for place, each in enumerate(settings) if np.isfinite(errors[each]).all()]
        positions = [place + 0.4 * number - 0.2 for place, _ in shown]
        style.boxes(
            axes, number, [errors[each] for _, each in shown], positions, f"α = 0.01 as {reading}", width=0.35
        )
    names = ["500, best η", "4,000, best η", "8,000, best η", "4,000, 2 η", "500, 16 η"]
    axes.set_xticks(range(len(names)), names)
    axes.set(yscale="log", ylabel="mean squared error (of the range, squared)", xlabel="prototypes")
    axes.legend()


EXPERIMENT = Experiment(
    name="several-eta",
    title="Several η on one set of prototypes",
    thesis="section 6.2.2, figure 6.7",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=("Learned is the simulated grasping experiment of chapter 5: see there (multimodal) what it models.",),
)
