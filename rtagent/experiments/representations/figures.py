"""Figure 4.4: errors, and times of a step, against the number of features."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.experiment import Figure
from rtagent.experiments.representations.configurations import DIMENSIONS
from rtagent.experiments.representations.points import Point
from rtagent.experiments.representations.times import Timed
from rtagent.experiments.statistics import interval

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def error_figure(points: Sequence[Point], reading: str, told: str, unit: str, name: str) -> Figure:
    """Return the figure of errors against features."""
    shape = points[-1].errors[reading].shape
    tiles = sum(not point.size for point in points)
    caption = (
        f"Figure 4.4, top ({told}): mean absolute error over the last tenth of {shape[0]} streams. "
        f"Dots: {tiles} tile codings, each in the mean over streams; lines: selective Kanerva coding, in the "
        f"mean over {shape[1]} seeds and all streams, with the 95 % interval over streams."
    )
    return Figure(name, caption, partial(_draw_errors, points, reading, unit), (7.0, 4.5))


def _draw_errors(points: Sequence[Point], reading: str, unit: str, canvas: Canvas) -> None:
    axes = canvas.subplots()
    for number, dimensions in enumerate(DIMENSIONS):
        own = [point for point in points if point.dimensions == dimensions and np.isfinite(point.mean(reading))]
        tiles, kanerva = [each for each in own if not each.size], [each for each in own if each.size]
        label = f"tile coding, {dimensions} dimensions"
        x, y = [each.features for each in tiles], [each.mean(reading) for each in tiles]
        style.series(axes, number, x, y, label, linestyle="none", markersize=3, alpha=0.5)
        ends = [interval(each.each_stream(reading)) for each in kanerva]
        x, label = [each.features for each in kanerva], f"selective Kanerva, {dimensions} dimensions"
        low, high = [each.low for each in ends], [each.high for each in ends]
        style.series(axes, number + 3, x, [each.middle for each in ends], label, low=low, high=high)
    _scale(axes, f"mean absolute error ({unit})")
    axes.set_yscale("linear")


def time_figure(plain: Sequence[Timed], compiled: Sequence[Timed]) -> Figure:
    """Return the figure of times against features, in both forms."""
    caption = (
        "Figure 4.4, bottom: mean time of a step, encoding and learning, on a stream of the sorting arm: "
        f"left the plain numpy forms ({len(plain)} representations), right the compiled ones ({len(compiled)})."
    )
    return Figure("4.4-times", caption, partial(_draw_times, plain, compiled), (9.0, 4.0))


def _draw_times(plain: Sequence[Timed], compiled: Sequence[Timed], canvas: Canvas) -> None:
    left, right = canvas.subplots(1, 2, sharey=True)
    for axes, found, title in ((left, plain, "plain numpy"), (right, compiled, "kernels")):
        for number, dimensions in enumerate(DIMENSIONS):
            own = sorted((each for each in found if each.dimensions == dimensions), key=lambda each: each.features)
            for place, called, sized in ((number, "tile coding", False), (number + 3, "selective Kanerva", True)):
                line = [each for each in own if bool(each.size) is sized]
                steps = [each.step * 1e6 for each in line]
                further = {} if sized else {"linestyle": "none"}  # of a size there are several tile codings
                x, label = [each.features for each in line], f"{called}, {dimensions} dim."
                style.series(axes, place, x, steps, label, **further)
        _scale(axes, "time of a step (µs)" if axes is left else "")
        axes.set_title(title)
    right.get_legend().remove()


def _scale(axes: Axes, label: str) -> None:
    axes.set(xscale="log", yscale="log", xlabel="features", ylabel=label)
    axes.legend(fontsize=7)
