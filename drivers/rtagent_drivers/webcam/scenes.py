"""What fake cameras see: objects that are brought to a hand and taken away, before a black wall.

The objects are those of Travnik's thesis (chapter 5): green and orange cylinders, plain or stepped, and the hand's
thumb at the left of the picture.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.random import Generator

from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec
from rtagent.units import ms, second
from rtagent_drivers.webcam.features import Features
from rtagent_drivers.webcam.pictures import RGB, YUYV, Colour, Layout, Pixels, picture_of

WALL: Colour = (8, 8, 8)
THUMB: Colour = (150, 150, 160)
COLOURS: dict[str, Colour] = {"green": (40, 170, 60), "orange": (230, 120, 20)}
AWAY = (2 * second, 4 * second)
SHOWN = (2 * second, 6 * second)
WAY = 500 * ms
"""How long an object takes into the picture, and out of it."""


class Clip(Protocol):
    """Frames, taken at their own times (ns since the clip began)."""

    rate: float
    """In Hz."""

    def taken(self, number: int) -> int:
        """Return when frame `number` was taken."""

    def pixels(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, width, 3), RGB."""

    def yuyv(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, 2 · width)."""


class Visit(NamedTuple):
    """An object that is in the picture from `start` to `end` (ns)."""

    start: int
    end: int
    colour: str
    stepped: bool


class Scene:
    """Objects before a hand; all that is random follows from `rng`. Times are in ns since it began."""

    def __init__(self, size: tuple[int, int], rng: Generator) -> None:
        self._width, self._height = size
        self._seed = int(rng.integers(1 << 63))
        self._visits: list[Visit] = []
        self._starts: list[int] = []
        self._walls: dict[Layout, Pixels] = {}

    def visits(self, until: int) -> Sequence[Visit]:
        """Return the visits that begin until `until`, and the next one."""
        while not self._visits or self._starts[-1] <= until:
            self._add()
        return self._visits

    def pixels(self, time: int, layout: Layout = RGB) -> Pixels:
        """Return the picture at `time`: shape (height, groups of a row, bytes of a group)."""
        pixels = self._wall(layout).copy()
        for top, bottom, left, right, colour in self._parts(time):
            pixels[top:bottom, left // layout.across : right // layout.across] = layout.bytes_of(colour)
        return pixels

    def _wall(self, layout: Layout) -> Pixels:
        if layout not in self._walls:
            shape = (self._height, self._width // layout.across, layout.group)
            self._walls[layout] = np.broadcast_to(layout.bytes_of(WALL), shape).copy()
        return self._walls[layout]

    def _parts(self, time: int) -> Iterator[tuple[int, int, int, int, Colour]]:
        """Yield (top, bottom, left, right, colour) of what stands before the wall."""
        width, height = self._width, self._height
        self.visits(time)
        place = bisect_right(self._starts, time) - 1
        visit = self._visits[place] if place >= 0 else None
        if visit is not None and time < visit.end:
            way = min(1.0, (time - visit.start) / WAY, (visit.end - time) / WAY)
            bottom, step = round(0.8 * height * way), round(0.4 * height * way)
            yield 0, bottom, width * 2 // 5, width * 3 // 5, COLOURS[visit.colour]
            if visit.stepped:
                yield 0, step, width * 3 // 10, width * 7 // 10, COLOURS[visit.colour]
        yield height // 3, height * 2 // 3, 0, width // 6, THUMB

    def _add(self) -> None:
        rng = np.random.default_rng((self._seed, len(self._visits)))
        begin = self._visits[-1].end if self._visits else 0
        start = begin + int(rng.integers(*AWAY))
        colour, stepped = tuple(COLOURS)[int(rng.integers(len(COLOURS)))], bool(rng.integers(2))
        self._visits.append(Visit(start, start + int(rng.integers(*SHOWN)), colour, stepped))
        self._starts.append(start)


class SceneClip:
    """A scene as a camera films it."""

    def __init__(self, scene: Scene, rate: float) -> None:
        self._scene, self.rate = scene, rate

    def taken(self, number: int) -> int:
        """Return when frame `number` was taken."""
        return round(number * second / self.rate)

    def pixels(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, width, 3), RGB."""
        return self._scene.pixels(self.taken(number))

    def yuyv(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, 2 · width)."""
        groups = self._scene.pixels(self.taken(number), YUYV)
        return groups.reshape(len(groups), -1)


class CameraWorld:
    """A scene before a camera, as a function of time: what is sensed of it."""

    def __init__(self, size: tuple[int, int], features: Features) -> None:
        self._size, self._features = size, features
        self.spec = DeviceSpec(sensors=features.specs)

    def begin(self, now: int, rng: Generator) -> None:
        """Begin with an empty hand."""
        self._began, self._scene = now, Scene(self._size, rng)

    def values(self, time: int) -> Values:
        """Return what is sensed of the picture at `time`."""
        return self._features(picture_of(self._scene.pixels(time - self._began)))

    def command(self, now: int, command: Command) -> Command:
        """Take no command: a camera has none."""
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return when objects came into the picture."""
        starts = [self._began + visit.start for visit in self._scene.visits(until - self._began)]
        return [Stimulus(start, "object") for start in starts if after < start <= until]

    def next_change(self, now: int) -> int | None:
        """Return when an object comes or goes next."""
        visits = self._scene.visits(now - self._began)
        times = [self._began + time for visit in visits[-2:] for time in (visit.start, visit.end)]
        return min(time for time in times if time > now)

    def make_safe(self, now: int) -> None:
        """Do nothing: it moves nothing."""

    def save(self) -> Saved:
        """Return nothing: all follows from when and from what it began."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""
