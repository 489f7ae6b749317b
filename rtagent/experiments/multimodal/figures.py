"""Figures 5.6 to 5.9."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rtagent.experience import FloatArray
from rtagent.experiments.experiment import Figure
from rtagent.experiments.grasping import COLOR, FINGERS, POSITION, SETTINGS
from rtagent.experiments.multimodal.errors import OTHERS, Errors, effect
from rtagent.experiments.style import boxes, series

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Lines = Mapping[str, Sequence[float]]
SIZES = {"trial": (7.5, 5.5)}
EFFECTS = {"small": 0.2, "medium": 0.5}
"""Cohen's names for effects."""


def stream(sample: Lines, what: str) -> Figure:
    """Return a sample of the stream (figure 5.6)."""
    caption = f"A sample of the stream, as figure 5.6: the inputs of “All”, and the glove ({what})."
    return Figure("stream", caption, partial(_draw_stream, sample=sample), (7.0, 4.5))


def of_reading(errors: Errors, what: str, number: int) -> list[Figure]:
    """Return the figures of one reading of α, the one of this `number`."""
    trials = {key: several[0]["trial"] for key, several in errors.items() if several[0]}
    captions = {
        "trial": "A trial of the test with the green cylinder, as figure 5.7: the sensor, its return, the "
        "prediction; first seed",
        "errors": "Root squared errors in the test, as figure 5.8, without those beyond 2 standard deviations from "
        "their mean; all seeds together",
        "effects": "Cohen's d of the errors of each kind of sensors alone against those of “All”, as figure 5.9, "
        "with intervals over seeds; positive: “All” errs less",
    }
    draws = {
        "trial": partial(_draw_trial, trials=trials),
        "errors": partial(_draw_boxes, errors=errors),
        "effects": partial(_draw_effects, errors=errors),
    }
    return [
        Figure(
            f"{name}-{number}", f"{captions[name]} ({what}).", draw, (7.5, 5.5) if name == "trial" else (6.5, 3.8)
        )
        for name, draw in draws.items()
    ]


def _draw_stream(canvas: Canvas, sample: Lines) -> None:
    groups = {"position": POSITION, "colour": COLOR, "glove": tuple(FINGERS.values())}
    rows = canvas.subplots(len(groups), sharex=True)
    for axes, (title, names) in zip(rows, groups.items(), strict=True):
        for number, name in enumerate(names):
            series(axes, number, sample["time"], sample[name], name.replace("_", " "), marker="")
        axes.set_ylabel(f"{title} (0 to 1)")
        axes.set_ylim(-0.05, 1.4)
        axes.legend(loc="upper right", ncols=3)
    rows[-1].set_xlabel("time (s)")


def _draw_trial(canvas: Canvas, trials: Mapping[tuple[str, str], Lines]) -> None:
    grid = canvas.subplots(len(FINGERS), len(SETTINGS), sharex=True, sharey=True, squeeze=False)
    for (setting, finger), trial in trials.items():
        axes = grid[list(FINGERS).index(finger)][list(SETTINGS).index(setting)]
        for number, name in enumerate(("signal", "prediction", "return")):
            series(axes, number, trial["time"], trial[name], name, marker="")
    for axes, setting in zip(grid[0], SETTINGS, strict=True):
        axes.set_title(setting)
    for axes, finger in zip(grid[:, 0], FINGERS, strict=True):
        axes.set_ylabel(f"{finger} (0 to 1)")
    for axes in grid[-1]:
        axes.set_xlabel("time in the trial (s)")
    canvas.legend(*grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _draw_boxes(canvas: Canvas, errors: Errors) -> None:
    axes = canvas.subplots()
    for number, setting in enumerate(SETTINGS):
        groups = [_without_outliers(errors[setting, finger]) for finger in FINGERS]
        boxes(axes, number, groups, [place + 0.25 * (number - 1) for place in range(3)], setting, width=0.22)
    axes.set_xticks(range(len(FINGERS)), list(FINGERS))
    axes.set_xlabel("finger")
    axes.set_ylabel("root squared error (of the sensor's range)")
    axes.legend()


def _without_outliers(several: Sequence[Any]) -> FloatArray:
    """Return the errors of all seeds, by their quantiles, those beyond 2 standard deviations left out."""
    kept = []
    for each in several:
        found = np.array(each["quantiles"])
        kept.append(found[np.abs(found - each["mean"]) < 2.0 * np.sqrt(each["variance"])])
    return np.concatenate(kept)


def _draw_effects(canvas: Canvas, errors: Errors) -> None:
    axes = canvas.subplots()
    for number, other in enumerate(OTHERS):
        found = [effect(errors, finger, other) for finger in FINGERS]
        places = [place + 0.15 * (number - 0.5) for place in range(len(FINGERS))]
        axes.vlines(places, [each.low for each in found], [each.high for each in found], color="0.4")
        series(axes, number, places, [each.middle for each in found], f"“All” against “{other}”", linestyle="none")
    for name, limit in EFFECTS.items():
        axes.axhline(limit, color="0.5", linestyle=":")
        axes.annotate(f"{name} effect", (2.45, limit), ha="right", va="bottom")
    axes.axhline(0.0, color="0.5")
    axes.set_xticks(range(len(FINGERS)), list(FINGERS))
    axes.set_xlim(-0.5, 2.5)
    axes.set_xlabel("finger")
    axes.set_ylabel("Cohen's d (standard deviations)")
    canvas.legend(loc="outside lower center", ncols=2)
