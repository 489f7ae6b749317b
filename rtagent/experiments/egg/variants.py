"""What is varied about Experiment 2: the speed of the arm, what an egg bears, what people are like, the schedule.

All of it was fixed before the first trial was run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rtagent.experiments.egg.conditions import REACTIVE_SARSA, SARSA
from rtagent.experiments.egg.trial import scheduled
from rtagent.experiments.experiment import Cell, Options
from rtagent.schedule import FIXED, PRESETS

MAIN = "as stated"
SPEEDS = (50, 100, 150, 200)
"""Of the arm, in degrees a second. The thesis states none; 100 is that of the scenario."""

USUAL_SPEED = 100
CONTROL_EPISODES, EACH = 10, 20
PRACTISED = 5
"""Of the control's episodes the last ones, when people have practised."""

BATCH = 10
"""So many people are a cell."""

SECONDS, SLICED_SECONDS = 0.1, 0.6
"""What a person's trial takes."""

TRAINED_LAG = "75ms"
"""At the usual speed: half a learning step until the stop, and as much as the braking way takes at full speed."""


@dataclass(frozen=True)
class Variant:
    """One way to do the experiment: further settings of the scenario, and the conditions that are mixed."""

    settings: Sequence[str] = ()
    mixed: Sequence[str] = (SARSA, REACTIVE_SARSA)


def _people(**participant: str | float) -> Variant:
    return Variant([f"devices.arm.participant.{name}={value}" for name, value in participant.items()])


def _at(speed: int) -> Variant:
    return Variant([f"task.velocity={speed}deg/s"])


def at_speed(speed: int) -> str:
    """Return the name of the variant with an arm of this speed (degrees a second)."""
    return MAIN if speed == USUAL_SPEED else f"arm at {speed}°/s"


def alone(preset: str) -> str:
    """Return the name of the variant in which one schedule has all episodes."""
    return f"{preset} alone"


VARIANTS: Mapping[str, Variant] = {
    MAIN: Variant(),
    **{at_speed(speed): _at(speed) for speed in SPEEDS if speed != USUAL_SPEED},
    "egg gives 2°": Variant(["devices.arm.give=2deg", "task.obstacle=92deg"]),
    "half the margin": _people(caution=0.5),
    "three quarters of the margin": _people(caution=0.75),
    "people do not adapt": _people(adaptation=0.0, lag=TRAINED_LAG),
    "people adapt twice as fast": _people(adaptation=0.4),
    "people react": _people(strategy="reacting"),
    **{alone(preset): Variant(scheduled(preset), (preset,)) for preset in FIXED},
}


def cells(options: Options) -> list[Cell]:
    """Return the cells: people in batches, the same in all variants; fewer where it is to be quick."""
    return [_cell(name, first) for name in VARIANTS for first in range(0, _people_of(name, options), BATCH)]


def _people_of(variant: str, options: Options) -> int:
    if options.quick:
        return 40 if variant == MAIN else 20
    return 400 if variant == MAIN else 200


def _cell(name: str, first: int) -> Cell:
    variant = VARIANTS[name]
    about: dict[str, Any] = {"variant": name, "seed": 1, "first": first, "people": BATCH}
    trial = {"control": CONTROL_EPISODES, "each": EACH, "mixed": list(variant.mixed)}
    return about | trial | {"settings": list(variant.settings)}


def seconds(cell: Cell) -> float:
    """Return about how long a cell takes on one processor."""
    sliced = any(PRESETS[preset].learn.slice for preset in cell["mixed"])
    return (SLICED_SECONDS if sliced else SECONDS) * float(cell["people"])
