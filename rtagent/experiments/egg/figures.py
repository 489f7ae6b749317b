"""The figures of Experiment 2: failed stops (3.5), times of events (3.6), and our other schedules."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rtagent.experiments import style
from rtagent.experiments.egg.conditions import CONTROL, NAMES, REACTIVE_SARSA, SARSA
from rtagent.experiments.egg.people import Group, Times, rate
from rtagent.experiments.egg.variants import EACH, MAIN, PRACTISED, SPEEDS, alone, at_speed
from rtagent.experiments.experiment import Figure
from rtagent.schedule import FIXED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

FAILED = (
    ("control", CONTROL, 0),
    ("SARSA", SARSA, 0),
    ("reactive SARSA", REACTIVE_SARSA, 0),
    (f"control, last {PRACTISED}", CONTROL, PRACTISED),
)
PERCENT, MS = 100.0, 1e3


def figures(groups: Mapping[str, Group]) -> list[Figure]:
    """Return the figures that these variants allow."""
    drawn = []
    if MAIN in groups:
        drawn += [failed_stops(groups), event_times(groups[MAIN])]
    presets = [preset for preset in FIXED if alone(preset) in groups]
    return [*drawn, schedules({preset: groups[alone(preset)] for preset in presets})] if presets else drawn


def failed_stops(groups: Mapping[str, Group]) -> Figure:
    """Return failed stops against the speed of the arm, a line for each condition (figure 3.5)."""
    speeds = [speed for speed in SPEEDS if at_speed(speed) in groups]
    people = ", ".join(f"{len(groups[at_speed(speed)].people)} at {speed}°/s" for speed in speeds)

    def draw(canvas: Canvas) -> None:
        axes = canvas.subplots()
        for number, (name, condition, last) in enumerate(FAILED):
            found = [rate(groups[at_speed(speed)], condition, last) for speed in speeds]
            low, middle, high = (
                [PERCENT * getattr(each, end) for each in found] for end in ("low", "middle", "high")
            )
            style.series(axes, number, speeds, middle, name, low=low, high=high)
        axes.set_xlabel("speed of the arm (°/s)")
        axes.set_ylabel("failed stops (%)")
        axes.set_ylim(bottom=0)
        axes.legend()

    caption = (
        f"Failed stops of modelled people ({people}): 10 episodes of control, then 20 each of both algorithms, "
        "shuffled. Bands: 95 % intervals over people."
    )
    return Figure("failed-stops", caption, draw)


def event_times(group: Group) -> Figure:
    """Return boxes of the times of presses and actions, for each condition (figure 3.6)."""

    def draw(canvas: Canvas) -> None:
        draw_events(canvas.subplots(), {name: _events(group, name) for name in NAMES})

    caption = (
        f"When {len(group.people)} modelled people pressed, and when the agent acted. Time runs from where the "
        "arm would have begun, had it had its full speed at once. Boxes: quartiles, median; whiskers: all."
    )
    return Figure("event-times", caption, draw)


def draw_events(axes: Axes, events: Mapping[str, tuple[Times, Times]]) -> None:
    """Draw two boxes for each condition: presses and actions, from their times in s."""
    for number, (name, which) in enumerate((("press", 0), ("agent's action", 1))):
        places = [3 * place + number for place in range(len(events))]
        times = [MS * both[which] for both in events.values()]
        style.boxes(axes, number, times, places, name)
    axes.set_xticks([3 * place + 0.5 for place in range(len(events))], [NAMES[name] for name in events])
    axes.set_ylabel("time since the arm began to move (ms)")
    axes.legend()


def schedules(groups: Mapping[str, Group]) -> Figure:
    """Return failed stops for each schedule, where it alone is met."""

    def draw(canvas: Canvas) -> None:
        axes = canvas.subplots()
        found = [rate(group, preset, EACH) for preset, group in groups.items()]
        middles = np.array([PERCENT * each.middle for each in found])
        ends = np.abs(np.array([[PERCENT * each.low, PERCENT * each.high] for each in found]).T - middles)
        axes.errorbar(range(len(found)), middles, yerr=ends, fmt="ks", capsize=4)
        axes.set_xticks(range(len(found)), list(groups))
        axes.set_ylabel("failed stops (%)")
        axes.set_ylim(bottom=0)

    people = min(len(group.people) for group in groups.values())
    caption = (
        f"Failed stops of {people} modelled people where one schedule has all episodes, practice left out: "
        f"the last {EACH} of each. Bars: 95 % intervals over people."
    )
    return Figure("schedules", caption, draw)


def _events(group: Group, condition: str) -> tuple[Times, Times]:
    return group.times(condition, "pressed"), group.times(condition, "acted")
