"""What a person's game came to: a table, and a figure of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments.egg.attempts import Attempt
from rtagent.experiments.egg.conditions import NAMES
from rtagent.experiments.egg.figures import draw_events
from rtagent.units import degree

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas
    from rich.table import Table

SIZE = (8.0, 3.6)


def table(attempts: Sequence[Attempt]) -> Table:
    """Return what came of the attempts in each condition: which are revealed here."""
    from rich.table import Table

    made = Table(
        "program", "attempts", "crushed", "whole eggs: distance", "press to action", box=None, pad_edge=False
    )
    for condition, name in NAMES.items():
        those = [each for each in attempts if each.condition == condition]
        crushed = sum(each.broken for each in those)
        made.add_row(name, str(len(those)), str(crushed), _distance(those), _gap(those))
    return made


def _distance(attempts: Sequence[Attempt]) -> str:
    whole = [each.short / degree for each in attempts if not each.broken]
    return f"{median(whole):.1f}°" if whole else ""


def _gap(attempts: Sequence[Attempt]) -> str:
    gaps = [
        1e3 * (each.acted - each.pressed)
        for each in attempts
        if each.acted is not None and each.pressed is not None
    ]
    return f"{median(gaps):.0f} ms" if gaps else ""


def draw(canvas: Canvas, attempts: Sequence[Attempt]) -> None:
    """Draw crushed eggs, and the times of presses and actions, by condition."""
    crushed, events = canvas.subplots(1, 2, width_ratios=(1, 2))
    there = [name for name in NAMES if any(each.condition == name for each in attempts)]
    counts = [sum(each.broken for each in attempts if each.condition == name) for name in there]
    crushed.bar(range(len(there)), counts, color="0.6", edgecolor="black")
    crushed.set_xticks(range(len(there)), [NAMES[name] for name in there], rotation=20)
    crushed.set_ylabel("crushed eggs")
    crushed.set_ylim(0, max(*counts, 4) + 1)
    crushed.locator_params(axis="y", integer=True)
    draw_events(events, {name: _events(attempts, name) for name in there})


def _events(attempts: Sequence[Attempt], condition: str) -> tuple[np.ndarray, np.ndarray]:
    those = [each for each in attempts if each.condition == condition]
    pressed = np.array([each.pressed for each in those if each.pressed is not None])
    return pressed, np.array([each.acted for each in those if each.acted is not None])


def write(attempts: Sequence[Attempt], stem: Path) -> str:
    """Write the figure as `stem`.png and `stem`.svg; return a sentence on that, or on what is missing for it."""
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure as Canvas
    except ImportError:
        return "There is no figure: it needs matplotlib: pip install 'rtagent[figures]'."
    from rtagent.experiments import style

    with mpl.rc_context(style.SETTINGS):
        canvas = Canvas(figsize=SIZE, layout="constrained")
        draw(canvas, attempts)
        written = style.save(canvas, stem)
    return f"Your figure: {' and '.join(map(str, written))}"
