"""The figures of learned ordering: what is earned over time, and where the time goes in calm and urgent phases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experiments import style
from rtagent.experiments.experiment import Figure, Row
from rtagent.experiments.learned_ordering.runs import LEARNED, PARTS, SCHEDULES, WORLDS
from rtagent.schedule import Component

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

Groups = Mapping[tuple[str, str], Sequence[Row]]
SHOWN = (Component.LEARN, Component.OBSERVE, Component.CHOOSE, Component.ACT, Component.ORDER, Component.WAIT)
PHASES = ("calm", "urgent")
FIRST = (LEARNED, *(name for name in SCHEDULES if name != LEARNED))
"""The schedules in the order of their looks: the one that this is about has the strongest."""


def figures(groups: Groups) -> tuple[Figure, ...]:
    """Return both figures."""
    count = len(groups[next(iter(WORLDS)), LEARNED])
    return (
        Figure(
            "earned",
            f"What is earned in each of {PARTS} equal parts of a run; the ordering begins with nothing learned. "
            f"Means over {count} seeds, with 95 % intervals of the mean (normal) for the learned ordering.",
            partial(_curves, groups),
            (10.0, 3.6),
        ),
        Figure(
            "shares",
            "Where the processor's time goes in calm and in urgent phases, under each schedule: means over "
            f"{count} seeds. The rest is waiting for a sample. background learns on a second processor.",
            partial(_shares, groups),
            (10.0, 4.6),
        ),
    )


def _panels(canvas: Canvas) -> list[Axes]:
    drawn: NDArray[Any] = canvas.subplots(1, len(WORLDS), squeeze=False)[0]
    return list(drawn)


def _curves(groups: Groups, canvas: Canvas) -> None:
    panels = _panels(canvas)
    for axes, (world, about) in zip(panels, WORLDS.items(), strict=True):
        for number, name in enumerate(FIRST):
            _curve(axes, number, name, groups[world, name])
        axes.set_title(world, fontsize="medium")
        axes.set_xlabel("part of the run")
        axes.set_ylabel(f"reward each {about.per}")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    canvas.set_layout_engine("constrained")


def _curve(axes: Axes, number: int, name: str, rows: Sequence[Row]) -> None:
    earned = np.array([row["earned"] for row in rows])
    middle, band = earned.mean(axis=0), {}
    if name == LEARNED and len(rows) > 1:
        error = 1.96 * earned.std(axis=0, ddof=1) / np.sqrt(len(rows))
        band = {"low": middle - error, "high": middle + error}
    style.series(axes, number, np.arange(1, PARTS + 1), middle, name, **band)


def _shares(groups: Groups, canvas: Canvas) -> None:
    panels = _panels(canvas)
    for axes, world in zip(panels, WORLDS, strict=True):
        names = [f"{name}, {phase}" for name in SCHEDULES for phase in PHASES]
        left = np.zeros(len(names))
        for number, component in enumerate(SHOWN):
            share = np.array(
                [_share(groups[world, name], phase, component) for name in SCHEDULES for phase in PHASES]
            )
            look = style.LINES[number]
            axes.barh(
                names, share, left=left, label=component.value, color=look.color, alpha=0.6, hatch=look.hatch,
                edgecolor="black", linewidth=0.4,
            )  # fmt: skip
            left += share
        axes.set_title(world, fontsize="medium")
        axes.set_xlabel("share of the time")
        axes.invert_yaxis()
        if axes is not panels[0]:
            axes.set_yticklabels([])
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(SHOWN))
    canvas.set_layout_engine("constrained")


def _share(rows: Sequence[Row], phase: str, component: Component) -> float:
    return float(np.mean([row["shares"].get(phase, {}).get(component.value, 0.0) for row in rows]))
