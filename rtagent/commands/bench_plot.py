"""A picture of comparisons: ratios with their intervals, and reaction times before and now."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rtagent.latencies.changes import Compared, Verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH, HEIGHT = 10.0, 3.6
"""Of a scenario, in inches."""

LEAST, MOST = 0.25, 4.0
"""Ratios beyond these are drawn at the edge."""


def is_there() -> bool:
    """Say whether pictures can be drawn."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return False
    return True


def draw(scenarios: Sequence[Compared], path: Path) -> None:
    """Draw a row for each scenario into a file; raises `OSError`, and `ValueError` for a kind of file unknown."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, HEIGHT * len(scenarios)), layout="constrained")
    rows = figure.subplots(len(scenarios), 2, squeeze=False)
    for (ratios, reactions), compared in zip(rows, scenarios, strict=True):
        _draw_ratios(ratios, compared)
        _draw_reactions(reactions, compared)
    figure.savefig(path)


def _draw_ratios(axes: Axes, compared: Compared) -> None:
    """Draw each ratio as a point on its interval; a regression is filled and black."""
    changes = [change for change in compared.changes if change.ratio is not None][::-1]
    for place, change in enumerate(changes):
        assert change.ratio is not None
        low, middle, high = np.clip((change.ratio.low, change.ratio.ratio, change.ratio.high), LEAST, MOST)
        colour = "black" if change.verdict is Verdict.SLOWER else "0.5"
        axes.plot((low, high), (place, place), color=colour, linewidth=2)
        axes.plot(middle, place, "o", color=colour, markerfacecolor=colour if colour == "black" else "white")
    axes.axvline(1.0, color="0.8", zorder=0)
    axes.axvline(compared.limit, color="0.4", linestyle="--", zorder=0)
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(changes)), [change.what for change in changes])
    axes.set_xlabel(f"times as long as before (dashed: the limit, {compared.limit:g})")
    axes.set_title(compared.title, loc="left", fontsize=10)


def _draw_reactions(axes: Axes, compared: Compared) -> None:
    """Draw which share of reactions took at most so long."""
    for times, name, style in zip(compared.reactions, ("before", "now"), ("--", "-"), strict=True):
        if times:
            share = np.arange(1, len(times) + 1) / len(times)
            axes.step(
                np.sort(times) / 1e6, share, style, color="black", where="post", label=f"{name} ({len(times)})"
            )
    if any(compared.reactions):
        axes.legend()
    axes.set_xlabel("reaction time (ms)")
    axes.set_ylabel("share of reactions")
