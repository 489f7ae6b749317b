"""What fake cameras see: the grasping experiment, in which objects are brought to a hand and taken away."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.random import Generator

from rtagent.experience import Command, FloatArray, Stimulus, Values
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec
from rtagent.streams import shared
from rtagent.units import second
from rtagent_drivers.emulation.world_time import began_on_the_wire
from rtagent_drivers.grasping.assumed import WALL
from rtagent_drivers.grasping.session import EXPERIMENT, Session, Times
from rtagent_drivers.grasping.view import View
from rtagent_drivers.webcam.features import COLOURS, Features
from rtagent_drivers.webcam.pictures import RGB, YUYV, Layout, Pixels, picture_of


class Clip(Protocol):
    """Frames, taken at their own times (ns since the clip began)."""

    rate: float
    """In Hz."""

    def begin(self, now: int) -> None:
        """Take note of when the clip begins, by the monotonic clock."""

    def taken(self, number: int) -> int:
        """Return when frame `number` was taken."""

    def pixels(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, width, 3), RGB."""

    def yuyv(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, 2 · width)."""


class Scene:
    """Objects before a hand; all that is random follows from `rng`. Times are in ns since it began."""

    def __init__(self, size: tuple[int, int], rng: Generator) -> None:
        self._width, self._height = size
        self.session = Session(shared(rng, EXPERIMENT))
        self.view = View(self.session, size)
        self._walls: dict[Layout, Pixels] = {}

    def pixels(self, time: int, layout: Layout = RGB) -> Pixels:
        """Return the picture at `time`: shape (height, groups of a row, bytes of a group)."""
        pixels = self._wall(layout).copy()
        for part in self.view.parts(np.array([time])):
            rows = slice(int(part.top[0]), int(part.bottom[0]))
            groups = slice(int(part.left[0]) // layout.across, int(part.right[0]) // layout.across)
            red, green, blue = part.colour[0].tolist()
            pixels[rows, groups] = layout.bytes_of((red, green, blue))
        return pixels

    def _wall(self, layout: Layout) -> Pixels:
        if layout not in self._walls:
            shape = (self._height, self._width // layout.across, layout.group)
            self._walls[layout] = np.broadcast_to(layout.bytes_of(WALL), shape).copy()
        return self._walls[layout]


class SceneClip:
    """A scene as a camera films it, which began with the world of all that is emulated."""

    def __init__(self, scene: Scene, rate: float) -> None:
        self._scene, self.rate, self._lead = scene, rate, 0

    def begin(self, now: int) -> None:
        """Begin in the midst of the scene."""
        self._lead = now - began_on_the_wire()

    def taken(self, number: int) -> int:
        """Return when frame `number` was taken."""
        return round(number * second / self.rate)

    def pixels(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, width, 3), RGB."""
        return self._scene.pixels(self._lead + self.taken(number))

    def yuyv(self, number: int) -> Pixels:
        """Return frame `number`: shape (height, 2 · width)."""
        groups = self._scene.pixels(self._lead + self.taken(number), YUYV)
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

    def columns(self, times: Times) -> Mapping[str, FloatArray]:
        """Return what is sensed at these times (ns), shape (n,); of means alone without drawing pictures."""
        if tuple(self.spec.sensors) == COLOURS:
            return dict(zip(COLOURS, self._scene.view.means(times - self._began), strict=True))
        rows = [self.values(time) for time in times.tolist()]
        return {name: np.array([row[name] for row in rows], float) for name in self.spec.sensors}

    def command(self, now: int, command: Command) -> Command:
        """Take no command: a camera has none."""
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return when objects came into the picture."""
        entries = self._scene.session.entries(after - self._began, until - self._began)
        return [Stimulus(self._began + entry, "object") for entry in entries]

    def next_change(self, now: int) -> int | None:
        """Return when something in the picture moves next."""
        return self._began + self._scene.session.next_change(now - self._began)

    def make_safe(self, now: int) -> None:
        """Do nothing: it moves nothing."""

    def save(self) -> Saved:
        """Return nothing: all follows from when and from what it began."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""
