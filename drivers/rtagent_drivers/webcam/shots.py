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


class Dates:
    """When frames were taken, by their stamps (ns; None where a camera gives none of the monotonic clock).

    A stamp may lie in the future, as that of a camera which says when a frame will have been transferred: such a
    frame is taken to be as old as its arrival, and `stamps_ahead` counts it. Times never go back.
    """

    def __init__(self, counters: Counter[str]) -> None:
        self._counters, self._last = counters, 0

    def shot(self, stamp: int | None, now: int, sequence: int) -> Shot:
        """Return the shot of a frame that arrived `now`."""
        if stamp is not None and stamp > now:
            self._counters["stamps_ahead"] += 1
            stamp = None
        self._last = max(now if stamp is None else stamp, self._last)
        return Shot(self._last, now, sequence, "arrival" if stamp is None else "device")
