"""How much η matters (thesis, section 6.1, figures 6.1 and 6.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row
from rtagent.experiments.ring_finger.errors import Errors, best, errors_of, ratio, spread_ratio
from rtagent.experiments.ring_finger.figure import error_figure
from rtagent.experiments.ring_finger.measuring import POINTS, measure
from rtagent.experiments.ring_finger.problem import (
    MODELS,
    QUICK_SEEDS,
    QUICKLY,
    READINGS,
    SEEDS,
    cell_of,
    seconds,
)
from rtagent.experiments.statistics import Interval, above, all_of, below, interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

SIZES = (250, 500, 1000, 2000, 4000, 8000, 12_000)
ETAS = (0.0025, 0.005, 0.01, 0.025, 0.05, 0.075, 0.1)
QUICK_SIZES, QUICK_ETAS = (250, 1000, 8000, 12_000), (0.005, 0.025, 0.1)
DIMENSIONS, DISTANCE_SEEDS = (1, 2, 4, 8), 50
"""Of figure 6.2: the thesis's own."""
IN_TIME = 0.0013
"""Seconds: what a step of 750 a second may take (thesis, section 6.1)."""

Pair = tuple[Cell, Row]


def cells(options: Options) -> list[Cell]:
    """Return the cells: errors, times of a step, and distances to the nearest prototype."""
    sizes, etas = (QUICK_SIZES, QUICK_ETAS) if options.quick else (SIZES, ETAS)
    seeds, every = (QUICK_SEEDS, QUICKLY) if options.quick else (SEEDS, 1)
    errors = [
        cell_of(size, [eta], seed, every)
        for size, eta, seed in product(sizes, etas, range(seeds))
        if size * eta >= 1.0
    ]
    times = [
        cell_of(size, [0.025], 0, every, kind="time", plain=plain) for size, plain in product(sizes, (True, False))
    ]
    distances = [
        {"kind": "distance", "dimensions": dimensions, "prototypes": size, "seeds": list(range(DISTANCE_SEEDS))}
        for dimensions, size in product(DIMENSIONS, sizes)
    ]
    return [*errors, *times, *distances]


def find(pairs: Sequence[Pair], options: Options) -> Findings:
    """Return what was found."""
    by_reading = {reading: errors_of(pairs, reading) for reading in READINGS}
    claims = [claim for reading, errors in by_reading.items() for claim in _error_claims(errors, reading)]
    claims += [*_time_claims(pairs), _distance_claim(pairs)]
    told = next(row["told"] for cell, row in pairs if cell["kind"] == "error")
    figures = [
        error_figure("6.1", errors, reading, told, lambda setting: f"{setting.prototypes:,} prototypes")
        for reading, errors in by_reading.items()
    ]
    return Findings(tuple(claims), (*figures, _distance_figure(pairs)), (), (f"Learned is {told}.",))


def _error_claims(errors: Errors, reading: str) -> Iterator[Claim]:
    sizes = sorted({setting.prototypes for setting in errors})
    leasts = {size: best(errors, size) for size in sizes}
    told = ", ".join(f"{leasts[size]} {errors[leasts[size]].mean():.3g}" for size in sizes)
    first, last = errors[leasts[sizes[0]]], errors[leasts[sizes[-1]]]
    gain = ratio(last, first)
    yield Claim(
        f"more prototypes err less, each with its best η ({reading})",
        "additional prototypes can decrease the prediction error",
        f"mean squared errors: {told}; {sizes[-1]:,} to {sizes[0]:,} {gain}",
        below(gain, 1.0),
    )
    early, late = (ratio(errors[leasts[more]], errors[leasts[less]]) for less, more in (sizes[:2], sizes[-2:]))
    yield Claim(
        f"with diminishing returns ({reading})",
        "with diminishing returns",
        f"{sizes[1]:,} to {sizes[0]:,} {early}; {sizes[-1]:,} to {sizes[-2]:,} {late}",
        above(Interval(late.low - early.high, late.middle - early.middle, late.high - early.low)),
    )
    yield Claim(
        f"{sizes[-1]:,} prototypes performed best of all ({reading})",
        "the setting with 12,000 prototypes performed the best",
        f"{sizes[-1]:,} to {sizes[-2]:,} {late}",
        below(late, 1.0),
    )
    yield _spread_claim(errors, sizes, reading)


def _spread_claim(errors: Errors, sizes: Sequence[int], reading: str) -> Claim:
    """Return: errors vary more with how prototypes are drawn where these are few."""
    said = f"how prototypes are drawn matters more where they are few and η is small ({reading})"
    theirs = "the smaller prototype sets show an increase in variability for small η"
    few, many = (
        min((each for each in errors if each.prototypes == size and np.isfinite(errors[each]).all()),
            key=lambda each: each.etas, default=None)
        for size in (sizes[0], sizes[-1])
    )  # fmt: skip
    if few is None or many is None:
        return Claim(said, theirs, "learning diverged", all_of([below(Interval(1.0, 1.0, 1.0))]))
    found = spread_ratio(errors[few], errors[many])
    return Claim(
        said, theirs, f"standard deviation over seeds by the mean: {few} to {many} {found}", above(found, 1.0)
    )


def _time_claims(pairs: Sequence[Pair]) -> Iterator[Claim]:
    for plain, form in ((True, "plain numpy"), (False, "kernels")):
        steps = {cell["prototypes"]: row["step"] for cell, row in pairs if cell.get("plain") is plain}
        largest, smaller = max(steps), max(size for size in steps if size < max(steps))
        yield Claim(
            f"{largest:,} prototypes take longer than the 1.3 ms of a step at 750 Hz ({form})",
            "it took longer than 0.0013 seconds",
            f"{largest:,}: {steps[largest] * 1e6:.3g} µs, {smaller:,}: {steps[smaller] * 1e6:.3g} µs a step",
            above(Interval(steps[largest], steps[largest], steps[largest]), IN_TIME),
            "another processor",
        )


def _distances(pairs: Sequence[Pair]) -> dict[tuple[int, int], list[list[float]]]:
    return {
        (cell["dimensions"], cell["prototypes"]): row["distances"]
        for cell, row in pairs
        if cell["kind"] == "distance"
    }


def _distance_claim(pairs: Sequence[Pair]) -> Claim:
    """Return: distances to the nearest prototype vary more where prototypes are few."""
    found = _distances(pairs)
    sizes = sorted({size for _, size in found})
    ratios = {
        dimensions: interval(
            np.std(found[dimensions, sizes[0]], axis=1) / np.std(found[dimensions, sizes[-1]], axis=1)
        )
        for dimensions in DIMENSIONS
    }
    return Claim(
        "distances to the nearest prototype vary more where prototypes are few",
        "larger variability in the average distance when smaller sets are randomly initialized (figure 6.2)",
        f"standard deviation with {sizes[0]:,} to that with {sizes[-1]:,}: "
        + ", ".join(f"{dimensions} dimensions {each}" for dimensions, each in ratios.items()),
        all_of(above(each, 1.0) for each in ratios.values()),
    )


def _distance_figure(pairs: Sequence[Pair]) -> Figure:
    caption = (
        f"Figure 6.2: distance from {POINTS} random points of the unit cube to their nearest prototypes, in "
        f"{', '.join(map(str, DIMENSIONS))} dimensions; {DISTANCE_SEEDS} sets of prototypes. Boxes: quartiles; "
        "whiskers: from the least to the greatest."
    )
    return Figure("6.2", caption, partial(_draw_distances, _distances(pairs)), (7.0, 4.0))


def _draw_distances(found: dict[tuple[int, int], list[list[float]]], canvas: Canvas) -> None:
    axes = canvas.subplots()
    sizes = sorted({size for _, size in found})
    for number, dimensions in enumerate(DIMENSIONS):
        groups = [np.ravel(found[dimensions, size]) for size in sizes]
        positions = [place + 0.2 * number - 0.3 for place in range(len(sizes))]
        style.boxes(axes, number, groups, positions, f"{dimensions} dim.", width=0.17)
    axes.set_xticks(range(len(sizes)), [f"{size:,}" for size in sizes])
    axes.set(xlabel="prototypes", ylabel="distance to the nearest prototype")
    axes.legend()


EXPERIMENT = Experiment(
    name="eta",
    title="How much η matters",
    thesis="section 6.1, figures 6.1 and 6.2",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=MODELS,
)
