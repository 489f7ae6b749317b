"""Hallway-World (thesis, section 3.2, figure 3.1): up a hallway, then left through its opening.

The hallway reaches from x = 0 to `width` and from y = 0 to `length`; at its upper end a passage of height
`opening` leads left to the goal at x = -`passage`. It starts
somewhere in the range `start`, and only sees whether there is a wall on its left.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Length, Speed, second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling

UP, LEFT = 0, 1
TOUCH = 1e-9
ON_THE_WAY, PLACE = ("_hits", "_openings", "_arrival"), ("_x", "_y", "_reward", "_steps")
"""What is saved of either world."""


@dataclass(frozen=True)
class Floor:
    """The walls; lengths in metres."""

    length: float
    width: float
    opening: float
    passage: float
    start: tuple[float, float]

    def draw_start(self, rng: Generator) -> tuple[float, float]:
        """Return a place (x, y) near the bottom."""
        return self.width / 2, float(rng.uniform(*self.start))

    def wall_left(self, y: float) -> bool:
        """Say whether there is a wall to the left at height `y`."""
        return y < self.length - self.opening - TOUCH

    def free_way(self, x: float, y: float, action: int) -> float:
        """Return how far the agent can move from (x, y)."""
        if action == UP:
            return self.length - y
        return x if self.wall_left(y) else x + self.passage

    def arrived(self, x: float) -> bool:
        """Say whether this is the goal."""
        return x <= -self.passage + TOUCH

    def spec(self, synchronous: bool) -> DeviceSpec:
        """Return what can be sensed and commanded."""
        return DeviceSpec(
            sensors={
                "x": Spec(unit="m", low=-self.passage - TOUCH, high=self.width),
                "y": Spec(unit="m", low=0.0, high=self.length + TOUCH),
                "wall_left": Spec.flag(),
                "arrived": Spec.flag(),
                "reward": Spec(high=0.0),
            },
            actuators={"move": Spec.discrete(2)},
            synchronous=synchronous,
        )

    def values(self, x: float, y: float, arrived: bool, reward: float) -> Values:
        """Return the sensors at a place."""
        return {"x": x, "y": y, "wall_left": self.wall_left(y), "arrived": arrived, "reward": reward}


class _Leg(NamedTuple):
    """Straight motion from `begin` to `end` (ns) in a direction, or rest (no direction)."""

    begin: int
    end: int | None
    x: float
    y: float
    direction: int | None


class HallwayWorld:
    """The asynchronous world: the agent keeps moving until it turns, hits a wall, or arrives.

    `reward` is the sum since the episode began: -1 for each wall hit, and on arrival minus the seconds that
    the episode took.
    """

    def __init__(self, floor: Floor, speed: float) -> None:
        self._floor, self._speed = floor, speed
        self.spec = floor.spec(synchronous=False)

    def begin(self, now: int, rng: Generator) -> None:
        """Put the agent at its start, at rest."""
        self._start = now
        self._legs = [_Leg(now, None, *self._floor.draw_start(rng), None)]
        self._hits: list[int] = []
        self._openings: list[int] = []
        self._arrival: int | None = None

    def values(self, time: int) -> Values:
        """Return the sensors at `time` (ns)."""
        x, y = self._place(time)
        arrived = self._arrival is not None and time >= self._arrival
        reward = -float(bisect_right(self._hits, time))
        if arrived and self._arrival is not None:
            reward -= (self._arrival - self._start) / second
        return self._floor.values(x, y, arrived, reward)

    def command(self, now: int, command: Command) -> Command:
        """Turn into a direction; one that is blocked at once is another hit."""
        action = int(command["move"])
        if self._arrival is not None and now >= self._arrival:
            return command
        leg = self._leg(now)
        if leg.direction != action:
            self._turn(now, action)
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the times at which the wall on the left ended."""
        return [Stimulus(time, "opening") for time in self._openings if after < time <= until]

    def next_change(self, now: int) -> int | None:
        """Return when the agent passes the end of the wall, or its present motion ends."""
        end = self._leg(now).end
        ahead = self._openings if end is None else [*self._openings, end]
        return min((time for time in ahead if time > now), default=None)

    def make_safe(self, now: int) -> None:
        """Stop the agent where it is."""
        if self._arrival is None or now < self._arrival:
            self._cut(now)

    def save(self) -> Saved:
        """Return its way, and what happened, or will, on it."""
        return save_fields(self, ON_THE_WAY) | {"legs": [list(leg) for leg in self._legs]}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        restore_fields(self, ON_THE_WAY, saved)
        self._legs = [_Leg(*leg) for leg in saved["legs"]]

    def _leg(self, time: int) -> _Leg:
        return self._legs[max(0, bisect_right(self._legs, time, key=lambda leg: leg.begin) - 1)]

    def _place(self, time: int) -> tuple[float, float]:
        leg = self._leg(time)
        until = time if leg.end is None else min(time, leg.end)
        way = self._speed * (until - leg.begin) / second
        if leg.direction is None:
            return leg.x, leg.y
        way = min(way, self._floor.free_way(leg.x, leg.y, leg.direction))
        return (leg.x, leg.y + way) if leg.direction == UP else (leg.x - way, leg.y)

    def _cut(self, now: int) -> None:
        """Forget what would have happened after `now`."""
        x, y = self._place(now)
        self._legs = [leg for leg in self._legs if leg.begin < now] + [_Leg(now, None, x, y, None)]
        self._hits = [time for time in self._hits if time <= now]
        self._openings = [time for time in self._openings if time <= now]
        self._arrival = None

    def _turn(self, now: int, action: int) -> None:
        self._cut(now)
        rest = self._legs.pop()
        x, y = rest.x, rest.y
        free = self._floor.free_way(x, y, action)
        end = now + ceil(free / self._speed * second)
        self._legs.append(_Leg(now, end, x, y, action))
        stop_x, stop_y = (x, y + free) if action == UP else (x - free, y)
        self._legs.append(_Leg(end, None, stop_x, stop_y, None))
        if action == LEFT and self._floor.arrived(stop_x):
            self._arrival = end
        else:
            self._hits.append(end)
        if action == UP and self._floor.wall_left(y):
            way = self._floor.length - self._floor.opening - y
            self._openings.append(now + ceil(way / self._speed * second))


class SynchronousHallwayWorld:
    """The synchronous twin: each action moves the agent by `step` (m), and nothing else moves it.

    `reward` is -1 for each wall hit, and on arrival minus the seconds that the steps would have taken.
    """

    def __init__(self, floor: Floor, speed: float, step: float) -> None:
        self._floor, self._step, self._step_seconds = floor, step, step / speed
        self.spec = floor.spec(synchronous=True)

    def begin(self, now: int, rng: Generator) -> None:
        """Put the agent at its start."""
        self._x, self._y = self._floor.draw_start(rng)
        self._reward, self._steps = 0.0, 0

    def values(self, time: int) -> Values:
        """Return the sensors, which change only with commands."""
        return self._floor.values(self._x, self._y, self._floor.arrived(self._x), self._reward)

    def command(self, now: int, command: Command) -> Command:
        """Move by one step, or up to the wall that is in the way."""
        if self._floor.arrived(self._x):
            return command
        action = int(command["move"])
        free = self._floor.free_way(self._x, self._y, action)
        way = min(self._step, free)
        self._x, self._y = (self._x, self._y + way) if action == UP else (self._x - way, self._y)
        self._steps += 1
        if self._floor.arrived(self._x):
            self._reward -= self._steps * self._step_seconds
        elif free < self._step - TOUCH:
            self._reward -= 1.0
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: nothing happens by itself."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return None: nothing happens by itself."""
        return None

    def make_safe(self, now: int) -> None:
        """Do nothing: it does not move by itself."""

    def save(self) -> Saved:
        """Return where it is, and what it earned."""
        return save_fields(self, PLACE)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        restore_fields(self, PLACE, saved)


def hallway(
    *,
    length: Length = 1.0,
    width: Length = 0.2,
    opening: Length = 0.3,
    passage: Length = 0.2,
    start: tuple[Length, Length] = (0.05, 0.15),
    speed: Speed = 2.0,
    synchronous: bool = False,
    step: Length = 0.1,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> FakeDevice:
    """Hallway-World (thesis, figure 3.1), which goes on by itself, or step by step if synchronous."""
    if min(length, width, opening, passage, speed, step) <= 0:
        raise SpecError("the lengths, the speed and the step are above 0.")
    if not 0 <= start[0] <= start[1] < length - opening:
        raise SpecError("start is [lowest, highest], in this order, from 0 to below the opening.")
    floor = Floor(length, width, opening, passage, start)
    world = SynchronousHallwayWorld(floor, speed, step) if synchronous else HallwayWorld(floor, speed)
    return FakeDevice(world, sampling, faults)
