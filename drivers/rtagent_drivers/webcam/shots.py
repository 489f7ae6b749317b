"""What back ends of a webcam have in common: shots, and what is wanted of a camera."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

from rtagent.experience import TimeSource, Values
from rtagent_drivers.webcam.features import Features

FormatName = Literal["YUYV", "MJPG"]


class Shot(NamedTuple):
    """A picture that the host has: when it was taken and had arrived (ns), its number since streaming began."""

    time: int
    arrival: int
    sequence: int
    time_source: TimeSource = "device"


@dataclass(frozen=True)
class Wanted:
    """What is wanted of a camera: `rate` in Hz, sizes in pixels."""

    device: str
    format: FormatName
    width: int
    height: int
    rate: float


class BackEnd(Protocol):
    """A way to a camera. All but the constructor belong to the event loop."""

    counters: Counter[str]

    @property
    def heard_at(self) -> int:
        """When (ns) the last frame came, looked at or not; 0 where none has."""

    async def open(self, wanted: Wanted, features: Features, told: Callable[[], None]) -> None:
        """Begin to stream; `told` is called whenever there may be something new. Raises `DisconnectedError`."""

    def newest(self) -> Shot | None:
        """Return the newest shot, if there is one yet; never waits. Raises `DisconnectedError` once it has gone."""

    async def sensed(self) -> tuple[Shot, Values]:
        """Return the newest shot, or one that was so a moment ago, with what is sensed of it."""

    async def close(self) -> None:
        """Let go of the camera; may be called more than once."""


def dated(stamp: int, now: int, last: int, counters: Counter[str]) -> int:
    """Return when a picture with such a stamp was taken: not after `now`, and not before the `last` one."""
    if stamp > now:
        counters["stamps_ahead"] += 1
    if stamp < last:
        counters["stamps_back"] += 1
    return max(min(stamp, now), last)
