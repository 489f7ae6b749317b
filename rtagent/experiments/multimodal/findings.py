"""What is found in the errors of all settings and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.experiments.experiment import Cell, Findings, Options, Row, Table
from rtagent.experiments.grasping import FINGERS, SETTINGS
from rtagent.experiments.multimodal import figures
from rtagent.experiments.multimodal.claims import claims_of
from rtagent.experiments.multimodal.errors import KEPT, Errors, diverged, number
from rtagent.experiments.multimodal.measuring import READINGS


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Return what the thesis claims beside what was found, with each reading of α."""
    by_reading = {reading: _errors(pairs, reading) for reading in READINGS if reading in pairs[0][1]["readings"]}
    what, (_, shown) = _what(pairs), next(each for each in pairs if each[0]["setting"] == "All")
    drawn = [figures.stream(shown["sample"], what)]
    for place, (reading, errors) in enumerate(by_reading.items()):
        if not diverged(errors):
            drawn += figures.of_reading(errors, f"α = 0.01 as {reading}; {what}", place)
    claims = [claim for reading, errors in by_reading.items() for claim in claims_of(errors, reading)]
    return Findings(tuple(claims), tuple(drawn), (_table(by_reading),))


def _errors(pairs: Sequence[tuple[Cell, Row]], reading: str) -> Errors:
    return {
        (setting, finger): [row["readings"][reading][finger] for cell, row in pairs if cell["setting"] == setting]
        for setting in SETTINGS
        for finger in FINGERS
    }


def _what(pairs: Sequence[tuple[Cell, Row]]) -> str:
    cell, row = pairs[0]
    seeds = len({cell["seed"] for cell, _ in pairs})
    features = f"{cell['prototypes']:,} prototypes, η {cell['eta']}"
    return f"{cell['trials']} trials ({row['steps']:,} steps), {features}, {seeds} seeds"


def _table(by_reading: Mapping[str, Errors]) -> Table:
    head = ("α = 0.01 as", "inputs", "finger", *KEPT.values())
    return Table(
        "Root squared errors after learning, in the range of the sensor, with intervals over seeds.",
        head,
        tuple(
            (reading, setting, finger, *_numbers(errors, setting, finger))
            for reading, errors in by_reading.items()
            for setting, finger in errors
        ),
    )


def _numbers(errors: Errors, setting: str, finger: str) -> list[str]:
    if None in errors[setting, finger]:
        return ["diverged"] * len(KEPT)
    return [str(number(errors, name, (setting, finger))) for name in KEPT]
