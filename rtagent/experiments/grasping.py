"""What is predicted from what in the grasping experiment (thesis, chapters 5 and 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rtagent.experiments.streams import Stream, named, seen_ranges

TRIALS = 131
"""31 with the green cylinder, 33 with each stepped one, 34 with the orange cylinder."""
COLOR, POSITION = ("red", "green"), ("index_intermediate", "ring_proximal")
SETTINGS: Mapping[str, tuple[str, ...]] = {
    "Color only": COLOR,
    "Position only": POSITION,
    "All": COLOR + POSITION,
}
FINGERS: Mapping[str, str] = {"middle": "middle_bend", "ring": "ring_bend", "pinky": "pinky_bend"}
DECAY = 0.999
"""Of the data traces, at 750 Hz."""
GAMMA, LAMBDA, ALPHA, ETA, TRAINED = 0.999, 0.9, 0.01, 0.025, 0.8
"""Of predictions and features; the part of the stream that is learned from."""


def grasping(trials: int, seed: int) -> Stream:
    """Return the stream of so many trials with the traces of its inputs; everything ranges over what is seen."""
    stream = named("grasping", trials=trials, seed=seed).traced(SETTINGS["All"], DECAY)
    return replace(stream, ranges=seen_ranges(stream.columns))


def inputs(setting: str) -> Sequence[str]:
    """Return the signals of an input setting: its own, and their traces."""
    return [*SETTINGS[setting], *(f"{name}_trace" for name in SETTINGS[setting])]
