"""Several sets of prototypes in place of one (thesis, section 6.2.1, figures 6.4 and 6.5)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.eta import ETAS
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Verdict
from rtagent.experiments.ring_finger.errors import Errors, Setting, best, errors_of, ratio, spread_ratio
from rtagent.experiments.ring_finger.figure import error_figure
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
from rtagent.experiments.statistics import Interval, above, all_of, compared, interval, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

TOTAL, SETS, ERROR_SETS = 8000, (1, 2, 4, 8, 16, 32, 64), (1, 2, 4, 16)
SIZES = (125, 250, 500, 1000, 2000, 4000, 8000)
ETA, TIMES, HALF = 0.05, 5, (0.35, 0.65)
"""Of figure 6.4; each time is taken so often; and what is roughly half."""
QUICK_SETS, QUICK_ETAS = (1, 4, 16), (0.005, 0.025)
PLAIN, KERNELS = "plain numpy", "kernels"

Pair = tuple[Cell, Row]
Steps = Mapping[tuple[int, int], Sequence[float]]
"""Times (s) of a step, by prototypes in all and sets."""


def cells(options: Options) -> list[Cell]:
    """Return the cells: errors of 8,000 prototypes in sets, and times, in sets and of fewer in one."""
    etas, sets = (QUICK_ETAS, QUICK_SETS) if options.quick else (ETAS, ERROR_SETS)
    seeds, every = (QUICK_SEEDS, QUICKLY) if options.quick else (SEEDS, 1)
    errors = [
        cell_of(TOTAL, [eta], seed, every, number)
        for number, eta, seed in product(sets, etas, range(seeds))
        if TOTAL // number * eta >= 1.0
    ]
    timed = [*((TOTAL, number) for number in SETS), *((size, 1) for size in SIZES[:-1])]
    times = [
        cell_of(size, [ETA], seed, every, number, kind="time", plain=plain)
        for (size, number), plain, seed in product(timed, (True, False), range(TIMES))
    ]
    return [*errors, *times]


def find(pairs: Sequence[Pair], options: Options) -> Findings:
    """Return what was found."""
    steps = {form: _steps(pairs, plain=form == PLAIN) for form in (PLAIN, KERNELS)}
    by_reading = {reading: errors_of(pairs, reading) for reading in READINGS}
    claims = [claim for form, found in steps.items() for claim in _time_claims(found, form)]
    claims += [claim for reading, errors in by_reading.items() for claim in _error_claims(errors, reading)]
    told = next(row["told"] for cell, row in pairs if cell["kind"] == "error")
    figures = [
        error_figure("6.5", errors, reading, told, lambda setting: f"{setting.sets} × {TOTAL // setting.sets:,}")
        for reading, errors in by_reading.items()
    ]
    return Findings(tuple(claims), (_time_figure(steps), *figures), (), (f"Learned is {told}.",))


def _steps(pairs: Sequence[Pair], *, plain: bool) -> dict[tuple[int, int], list[float]]:
    found: dict[tuple[int, int], list[float]] = {}
    for cell, row in pairs:
        if cell.get("plain") is plain:
            found.setdefault((cell["prototypes"], cell["sets"]), []).append(row["step"])
    return found


def _time_claims(steps: Steps, form: str) -> Iterator[Claim]:
    line = {sets: steps[TOTAL, sets] for sets in SETS}
    quickest = min(line, key=lambda sets: float(np.median(line[sets])))
    ends = [_times(line[end], line[quickest]) for end in (SETS[0], SETS[-1])]
    within_it = quickest not in (SETS[0], SETS[-1])
    yield Claim(
        f"the time of a step has a bowl's shape over the number of sets ({form})",
        "the bowl shape: the total time depends on the number and the size of the subsets (figure 6.4)",
        f"quickest with {quickest} sets; one set takes {ends[0]} times as long, {SETS[-1]} sets {ends[1]}",
        all_of(above(each, 1.0) for each in ends) if within_it else Verdict.NOT_REPRODUCED,
        f"a step with one set of {SIZES[0]} takes {np.median(steps[SIZES[0], 1]) * 1e6:.3g} µs: what it takes "
        f"beside its prototypes, each set takes; one of {TOTAL:,} takes {np.median(line[1]) * 1e6:.3g} µs",
    )
    four = _times(line[4], line[1])
    yield Claim(
        f"4 sets of 2,000 take roughly half the time of one of 8,000 ({form})",
        "it can be computed in roughly half of the time",
        f"{four} of the time",
        within(four, *HALF),
    )


def _times(ours: Sequence[float], others: Sequence[float]) -> Interval:
    return compared(ours, others, lambda one, other: one / other, np.median)


def _error_claims(errors: Errors, reading: str) -> Iterator[Claim]:
    one, several = best(errors, TOTAL), _best_of_several(errors)
    found = ratio(errors[several], errors[one])
    yield Claim(
        f"several sets have no advantage over one of {TOTAL:,} ({reading})",
        "these results do not indicate any advantage to using multiple prototype sets (figure 6.5)",
        f"{several} {errors[several].mean():.3g}, {one} {errors[one].mean():.3g}; ratio {found}",
        above(found, 1.0),
    )
    sets = max(setting.sets for setting in errors)
    eta = min(setting.etas for setting in errors if setting.sets == sets)
    small, whole = errors[Setting(TOTAL, sets, eta)], errors[Setting(TOTAL, 1, eta)]
    finite = np.isfinite(small).all() and np.isfinite(whole).all()
    wider = spread_ratio(small, whole) if finite else Interval(0.0, 0.0, 0.0)
    yield Claim(
        f"the smaller a set, the more errors vary where η is small ({reading})",
        "the smaller a prototype subset, the more variability in prediction accuracy for small η",
        f"standard deviation over seeds by the mean, {sets} sets to one with η = {eta[0]:g}: {wider}",
        above(wider, 1.0),
    )


def _best_of_several(errors: Errors) -> Setting:
    settings = [best(errors, TOTAL, sets) for sets in sorted({each.sets for each in errors}) if sets > 1]
    return min(settings, key=lambda each: float(errors[each].mean()))


def _time_figure(steps: Mapping[str, Steps]) -> Figure:
    caption = (
        f"Figure 6.4: time of a step, η = {ETA:g}, medians of {TIMES} with their 95 % intervals: one set, by its "
        f"size, and {TOTAL:,} prototypes in sets of that size; left in plain numpy, right with kernels."
    )
    return Figure("6.4", caption, partial(_draw_times, steps), (8.0, 3.8))


def _draw_times(steps: Mapping[str, Steps], canvas: Canvas) -> None:
    for axes, (form, found) in zip(np.ravel(canvas.subplots(1, 2)), steps.items(), strict=True):
        lines = {
            "one set of so many": [(size, found[size, 1]) for size in SIZES],
            f"{TOTAL:,} in sets of so many": [(TOTAL // sets, found[TOTAL, sets]) for sets in SETS],
        }
        for number, (label, line) in enumerate(lines.items()):
            ends = [interval(np.array(times) * 1e6, np.median) for _, times in line]
            x, low, high = [size for size, _ in line], [each.low for each in ends], [each.high for each in ends]
            style.series(axes, number, x, [each.middle for each in ends], label, low=low, high=high)
        axes.set(xscale="log", yscale="log", xlabel="prototypes of a set", ylabel="time of a step (µs)", title=form)
        axes.legend()
        axes.xaxis.set_minor_formatter("")


EXPERIMENT = Experiment(
    name="prototype-sets",
    title="Several sets of prototypes",
    thesis="section 6.2.1, figures 6.4 and 6.5",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(*MODELS, "Sets are of equal size; the thesis has unequal ones too."),
)
