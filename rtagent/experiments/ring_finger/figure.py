"""Figures 6.1 and 6.5: errors by η, a line for each of several representations."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.experiment import Figure
from rtagent.experiments.ring_finger.errors import Errors, Setting
from rtagent.experiments.ring_finger.problem import DIVIDED
from rtagent.experiments.statistics import interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Line = Callable[[Setting], str]
"""Says to which line a setting belongs."""


def error_figure(number: str, errors: Errors, reading: str, told: str, line: Line) -> Figure:
    """Return the figure of that number for one reading of α; `told` says what was learned."""
    seeds = len(next(iter(errors.values())))
    caption = (
        f"Figure {number} ({reading}): mean squared error over the last fifth of {told}, by η; mean over {seeds} "
        "seeds with its 95 % interval. What diverged is left out."
    )
    name = f"{number}-{'divided' if reading == DIVIDED else 'each'}"
    return Figure(name, caption, partial(_draw, errors, line))


def _draw(errors: Errors, line: Line, canvas: Canvas) -> None:
    axes = canvas.subplots()
    ordered = sorted(setting for setting in errors if np.isfinite(errors[setting]).all())
    for number, label in enumerate(dict.fromkeys(map(line, sorted(errors)))):
        own = [setting for setting in ordered if line(setting) == label]
        ends = [interval(errors[setting]) for setting in own]
        x, low, high = [each.etas[0] for each in own], [each.low for each in ends], [each.high for each in ends]
        style.series(axes, number, x, [each.middle for each in ends], label, low=low, high=high)
    axes.set(xscale="log", yscale="log", xlabel="η", ylabel="mean squared error (of the range, squared)")
    canvas.legend(loc="outside right center")
