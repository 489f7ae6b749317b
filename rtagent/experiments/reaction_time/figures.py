"""The figures of Experiment 1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.experiment import Cell, Figure, Row
from rtagent.experiments.reaction_time.groups import Groups, delays, median, reactions, reward, schedules, values
from rtagent.experiments.reaction_time.trials import LATE, THESIS, Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

DELAY = "time that learning takes, for each step (ms)"


def figures(groups: Groups, pairs: Sequence[tuple[Cell, Row]]) -> tuple[Figure, ...]:
    """Return figure 3.4, the distributions of reactions, and the medians of all schedules."""
    run = _run(groups, pairs)
    return (
        Figure(
            "reward",
            f"As figure 3.4: summed reward over the last {LATE} episodes of each trial, by what learning takes. "
            f"Boxes: quartiles and median; whiskers: all trials. {run}",
            partial(
                _boxed,
                groups,
                THESIS,
                partial(values, value=reward),
                f"reward of the last {LATE} episodes (−s in Emergency)",
            ),
        ),
        Figure(
            "reactions",
            f"All reaction times in the last {LATE} episodes. Boxes: quartiles and median; whiskers: all. {run}",
            partial(_boxed, _late(groups), THESIS, reactions, "reaction time (ms)"),
        ),
        Figure(
            "schedules",
            f"Median reaction time of all schedules. {run}",
            partial(_medians, groups),
        ),
    )


def _run(groups: Groups, pairs: Sequence[tuple[Cell, Row]]) -> str:
    trials = ", ".join(str(count) for count in sorted({len(trials) for trials in groups.values()}))
    cell = pairs[0][0]
    costs = ", ".join(f"{component} {cost}" for component, cost in cell.get("costs", {}).items())
    charged = f"; virtual clock, charged for {costs}" if costs else "; real clock"
    return f"{trials} trials of {cell['episodes']} episodes each{charged}."


def _late(groups: Groups) -> Groups:
    """Leave out what learns nothing: its reactions are too short to be seen beside the others."""
    return {(schedule, delay): trials for (schedule, delay), trials in groups.items() if delay > 0}


def _boxed(
    groups: Groups,
    shown: Sequence[str],
    drawn: Callable[[Sequence[Trial]], Sequence[float]],
    label: str,
    canvas: Canvas,
) -> None:
    axes, places = canvas.add_subplot(), np.arange(len(delays(groups)))
    for number, schedule in enumerate(shown):
        boxes = [drawn(groups[schedule, delay]) for delay in delays(groups)]
        style.boxes(axes, number, boxes, list(places + 0.36 * (number - 0.5)), schedule, width=0.32)
    axes.set_xticks(places, [f"{delay:g}" for delay in delays(groups)])
    axes.set_xlabel(DELAY)
    axes.set_ylabel(label)
    axes.legend(title="schedule", loc="best")


def _medians(groups: Groups, canvas: Canvas) -> None:
    axes: Axes = canvas.add_subplot()
    for number, schedule in enumerate(schedules(groups)):
        over = [delay for delay in delays(groups) if (schedule, delay) in groups]
        middle = [np.median(values(groups[schedule, delay], median)) for delay in over]
        style.series(axes, number, over, middle, schedule)
    axes.set_yscale("log")
    axes.set_xlabel(DELAY)
    axes.set_ylabel("median reaction time (ms)")
    axes.legend(title="schedule", loc="center left", bbox_to_anchor=(1.0, 0.5))
