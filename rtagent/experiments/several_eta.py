"""Several η on one set of prototypes (thesis, section 6.2.2, figure 6.7)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.eta import ETAS
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Verdict
from rtagent.experiments.ring_finger.errors import Errors, Setting, best, errors_of, ratio, spread_ratio
from rtagent.experiments.ring_finger.measuring import measure
from rtagent.experiments.ring_finger.problem import (
    MODELS,
    QUICK_SEEDS,
    QUICKLY,
    READINGS,
    SEEDS,
    cell_of,
    seconds,
)
from rtagent.experiments.statistics import Interval, above, below, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

SIZES = (500, 4000, 8000)
QUICK_ETAS = (0.0025, 0.01, 0.025)
SIXTEENS = tuple(
    tuple(float(eta) for eta in spaced(0.0025, 0.075, 16).round(6)) for spaced in (np.linspace, np.geomspace)
)
"""Sixteen η for 500 prototypes, evenly spaced or in a geometric series: the thesis does not say which."""
PAIRS = ((0.05, 0.1), (0.01, 0.025), (0.0025, 0.01))
"""Two η for 4,000 prototypes: the pair that the thesis names, and two of smaller ones. The best is compared."""
LITTLE = (0.9, 1.1)
"""Ratios of errors that are little different."""

Pair = tuple[Cell, Row]


def cells(options: Options) -> list[Cell]:
    """Return the cells: one η of several sizes, two η of 4,000 prototypes, sixteen of 500."""
    etas = QUICK_ETAS if options.quick else ETAS
    seeds, every = (QUICK_SEEDS, QUICKLY) if options.quick else (SEEDS, 1)
    several = [*((4000, pair) for pair in PAIRS), *((500, each) for each in SIXTEENS)]
    settings = [*((size, (eta,)) for size, eta in product(SIZES, etas)), *several]
    return [cell_of(size, own, seed, every) for (size, own), seed in product(settings, range(seeds))]


def find(pairs: Sequence[Pair], options: Options) -> Findings:
    """Return what was found."""
    by_reading = {reading: errors_of(pairs, reading) for reading in READINGS}
    claims = [claim for reading, errors in by_reading.items() for claim in _claims(errors, reading)]
    told = pairs[0][1]["told"]
    return Findings(tuple(claims), (_figure(by_reading, told),), (), (f"Learned is {told}.",))


def _claims(errors: Errors, reading: str) -> Iterator[Claim]:
    few, middle, many = (best(errors, size) for size in SIZES)
    two, sixteen = _several(errors)
    against = f"({reading})"
    found = ratio(errors[sixteen], errors[few])
    yield Claim(
        f"500 prototypes err less with 16 η than with the best one {against}",
        "by using 16 η values the error drops substantially",
        f"{errors[sixteen].mean():.3g}; {few} {errors[few].mean():.3g}; ratio {found}",
        below(found, 1.0),
        _lost(errors, 500, SIXTEENS),
    )
    found = ratio(errors[sixteen], errors[many])
    yield Claim(
        f"500 prototypes with 16 η are not as good as 8,000 with one {against}",
        "not as good as the performance of the original setting with 8000 prototypes and η = 0.0025",
        f"{errors[sixteen].mean():.3g}; {many} {errors[many].mean():.3g}; ratio {found}",
        above(found, 1.0) if np.isfinite(errors[sixteen]).all() else Verdict.NOT_REPRODUCED,
    )
    found = ratio(errors[two], errors[middle])
    yield Claim(
        f"4,000 prototypes are little different with two η {against}",
        "little difference between the 4000 prototype settings",
        f"η = {two.etas[0]:g} and {two.etas[1]:g} {errors[two].mean():.3g}; {middle} {errors[middle].mean():.3g}; "
        f"ratio {found}",
        within(found, *LITTLE),
        _lost(errors, 4000, PAIRS),
    )
    yield _varies_less(errors[two], errors[middle], against)


def _best_of(errors: Errors, prototypes: int, several: Sequence[tuple[float, ...]]) -> Setting:
    settings = [Setting(prototypes, 1, etas) for etas in several]
    return min(settings, key=lambda each: float(errors[each].mean()))


def _lost(errors: Errors, prototypes: int, several: Sequence[tuple[float, ...]]) -> str:
    """Say with which η learning diverged: by the first two and the last of them."""
    lost = [etas for etas in several if not np.isfinite(errors[Setting(prototypes, 1, etas)]).all()]
    told = (f"{etas[0]:.3g}, {etas[1]:.3g}{f', … {etas[-1]:.3g}' if etas[2:] else ''}" for etas in lost)
    return "; ".join(f"with η = {each} learning diverges" for each in told)


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
        f"prototypes, 4,000 with the best two η and 500 with the best 16; boxes over {seeds} seeds, α read both "
        "ways. What diverged is left out."
    )
    return Figure("6.7", caption, partial(_draw, by_reading), (7.5, 4.0))


def _several(errors: Errors) -> tuple[Setting, Setting]:
    return _best_of(errors, 4000, PAIRS), _best_of(errors, 500, SIXTEENS)


def _draw(by_reading: dict[str, dict[Setting, np.ndarray]], canvas: Canvas) -> None:
    axes = canvas.subplots()
    for number, (reading, errors) in enumerate(by_reading.items()):
        settings = [*(best(errors, size) for size in SIZES), *_several(errors)]
        shown = [(place, each) for place, each in enumerate(settings) if np.isfinite(errors[each]).all()]
        positions = [place + 0.4 * number - 0.2 for place, _ in shown]
        style.boxes(axes, number, [errors[each] for _, each in shown], positions, f"{reading}", width=0.35)
    names = ["500, best η", "4,000, best η", "8,000, best η", "4,000, 2 η", "500, 16 η"]
    axes.set_xticks(range(len(names)), names)
    axes.set(yscale="log", ylabel="mean squared error (of the range, squared)", xlabel="prototypes")
    canvas.legend(loc="outside lower center", ncols=2)


EXPERIMENT = Experiment(
    name="several-eta",
    title="Several η on one set of prototypes",
    thesis="section 6.2.2, figure 6.7",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=MODELS,
)
