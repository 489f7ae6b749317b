"""What a replay needs of a run, in the order in which it happened; times are in ns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from rtagent.experience import Observation


class Began(NamedTuple):
    """An episode began."""

    trial: int
    episode: int
    time: int


class Observed(NamedTuple):
    """The agent observed."""

    observation: Observation


class Chose(NamedTuple):
    """An action was chosen, when `learned` transitions of the trial had been learned, and `pieces` of the next."""

    action: int
    probability: float
    learned: int
    pieces: int


class Acted(NamedTuple):
    """The action that was chosen last was handed to the devices."""


class Learned(NamedTuple):
    """The next transition was learned: the learner's error."""

    delta: float


class Ended(NamedTuple):
    """The episode ended; one that was broken off has none of these."""


class Knew(NamedTuple):
    """The trial ended, its agent having learned what has this digest."""

    digest: str


Event = Began | Observed | Chose | Acted | Learned | Ended | Knew


@dataclass(frozen=True)
class Recorded:
    """A recording: the resolved `scenario` of its run, and what happened."""

    scenario: Mapping[str, Any]
    events: Iterable[Event]
