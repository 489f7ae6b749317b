"""The one style of all figures: series that stay apart in grey and for those who see colours differently."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas
    from numpy.typing import ArrayLike

SETTINGS: Any = {
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 9.0,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.0,
    "svg.hashsalt": "rtagent",  # the same figure gives the same bytes
}
DOTS_PER_INCH = 150
BAND = 0.15
"""The opacity of the interval around a line."""


class Line(NamedTuple):
    """How a series looks: its colour, its dashes and its marker, and the hatching of its boxes."""

    color: str
    linestyle: str | tuple[int, tuple[int, ...]]
    marker: str
    hatch: str


LINES = (
    Line("#000000", "-", "s", "///"),
    Line("#56b4e9", "-", "o", ""),
    Line("#d55e00", "--", "^", "\\\\\\"),
    Line("#e69f00", "-.", "D", "..."),
    Line("#0072b2", ":", "v", "xxx"),
    Line("#cc79a7", (0, (5, 1, 1, 1, 1, 1)), "P", "---"),
    Line("#117733", (0, (8, 2)), "X", "+++"),
    Line("#b0b0b0", (0, (3, 1)), "<", "|||"),
    Line("#882255", (0, (1, 2)), ">", "ooo"),
    Line("#88ccaa", (0, (6, 1, 2, 1)), "*", "***"),
)
"""After Okabe and Ito, and Tol; neighbours differ in lightness, and no two share dashes, marker or hatching."""


def series(
    axes: Axes,
    number: int,
    x: ArrayLike,
    y: ArrayLike,
    label: str = "",
    *,
    low: ArrayLike | None = None,
    high: ArrayLike | None = None,
    **further: Any,
) -> None:
    """Draw series `number` (from 0) as a line, in a band from `low` to `high` where they are given.

    `further` goes to matplotlib's `plot`: such as `markevery`, or `linestyle="none"` for points alone.
    """
    line = LINES[number % len(LINES)]
    look = {"color": line.color, "linestyle": line.linestyle, "marker": line.marker} | further
    axes.plot(x, y, label=label or None, **look)
    if low is not None and high is not None:
        axes.fill_between(x, low, high, color=line.color, alpha=BAND, linewidth=0)


def boxes(
    axes: Axes,
    number: int,
    groups: Sequence[ArrayLike],
    positions: Sequence[float],
    label: str = "",
    *,
    width: float = 0.7,
    whiskers: float | tuple[float, float] = (0, 100),
) -> None:
    """Draw a box for each group of values of series `number`, at their positions along the x axis.

    The box reaches from the lower to the upper quartile, with a line at the median; whiskers reach as matplotlib's
    `whis` says: by default over all values.
    """
    line = LINES[number % len(LINES)]
    drawn = axes.boxplot(
        groups, positions=positions, widths=width, whis=whiskers, patch_artist=True, manage_ticks=False,
        flierprops={"marker": line.marker, "markersize": 3}, medianprops={"color": "black", "linewidth": 2},
    )  # fmt: skip
    for box in drawn["boxes"]:
        box.set(facecolor=_pale(line.color), edgecolor="black", hatch=line.hatch)
    axes.bar(
        [positions[0]], [0], width=0, color=_pale(line.color), edgecolor="black", hatch=line.hatch, label=label
    )


def save(canvas: Canvas, stem: Path) -> tuple[Path, Path]:
    """Write a figure as `stem`.png and `stem`.svg; return both."""
    import matplotlib as mpl

    png, svg = stem.with_name(f"{stem.name}.png"), stem.with_name(f"{stem.name}.svg")
    with mpl.rc_context(SETTINGS):
        canvas.savefig(png, dpi=DOTS_PER_INCH)
        canvas.savefig(svg, metadata={"Date": None})
    return png, svg


def _pale(color: str) -> tuple[float, ...]:
    """Return a colour half way to white, on which hatching and a median can be seen."""
    parts = (int(color[place : place + 2], 16) / 255 for place in (1, 3, 5))
    return tuple((1 + part) / 2 for part in parts)
