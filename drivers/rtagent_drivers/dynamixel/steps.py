"""What acts on a joint, a servo or a hand, and the steps of constant acceleration in which it then moves.

Positions are in rad, velocities in rad/s, loads and torques in fractions of the servo's full load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import copysign, cos, inf, sqrt, tanh
from typing import NamedTuple, Protocol

from rtagent.errors import SpecError

OVERLOADED_AFTER = 1.0
"""A servo that stands still at its torque limit lets go after so long (s)."""

FOREVER = 1e9
"""What takes longer (s) does not end."""

GRAIN = 0.005
"""What moves freely is followed in pieces so long (s)."""

BACKDRIVE = 0.4
"""Damping of a gearbox that is turned from outside, per rad/s: a limp arm sinks, it does not drop."""

LUBRICATION = 0.02
"""Load that one rad/s takes."""

STILL = 1e-9
"""Ways (rad) and speeds (rad/s) too small to matter."""
CREEP, STICTION = 0.01, 1.2
"""What moves freely, slower than this (rad/s), sticks where less pulls it than this many times its friction."""
STEADY = 1e-3
"""Acceleration (rad/s²) below which a speed is constant."""


@dataclass(frozen=True)
class Body:
    """What a servo moves: `inertia` is the load that 1 rad/s² takes, `gravity` that of the level arm (at 0 rad).

    `friction` is the load that a turn takes at any speed; `low` and `high` are where the joint meets its stops.
    """

    inertia: float = 0.02
    gravity: float = 0.0
    friction: float = 0.05
    low: float = -inf
    high: float = inf

    def __post_init__(self) -> None:
        if not (self.inertia > 0.0 and self.friction > 0.0 and self.low <= self.high):
            raise SpecError("a body has inertia and friction above 0, and low is not above high.")

    def needed(self, position: float, velocity: float, acceleration: float) -> float:
        """Return the load that a motion takes."""
        turning = self.friction * tanh(velocity / 0.1) + LUBRICATION * velocity
        return self.inertia * acceleration + self.gravity * cos(position) + turning

    def most_acceleration(self, limit: float) -> float:
        """Return what acceleration (rad/s²) is left to a torque `limit` at the worst angle; 0 or less: none."""
        return (limit - abs(self.gravity) - self.friction) / self.inertia


class Step(NamedTuple):
    """A stretch of constant acceleration; `effort` is the load where it does not follow from the motion."""

    duration: float
    position: float
    velocity: float
    acceleration: float = 0.0
    effort: float | None = None
    stalled: bool = False
    overloaded: bool = False

    def after(self, elapsed: float) -> tuple[float, float]:
        """Return position and velocity `elapsed` seconds after it began."""
        velocity = self.velocity + self.acceleration * elapsed
        return self.position + 0.5 * (self.velocity + velocity) * elapsed, velocity

    def leaves(self, end: float, outwards: float) -> float | None:
        """Return when (s) it goes beyond `end`, outwards being +1 or -1, or None."""
        gap, speed, surge = (end - self.position) * outwards, self.velocity * outwards, self.acceleration * outwards
        if gap <= STILL:
            return 0.0 if speed > 0 or (speed == 0 and surge > 0) else self._returns(speed, surge)
        root = speed * speed + 2.0 * surge * gap
        if root < 0 or (root == 0 and surge < 0) or (speed <= 0 and surge <= 0):
            return None
        time = 2.0 * gap / (speed + sqrt(root)) if speed + sqrt(root) > 0 else inf
        return time if time < min(self.duration, FOREVER) else None

    def _returns(self, speed: float, surge: float) -> float | None:
        """Return when one that begins at the end and goes inwards is back there."""
        time = -2.0 * speed / surge if surge > 0 else inf
        return time if time < min(self.duration, FOREVER) else None


class Drive(Protocol):
    """What a servo, or a hand, does to its joint until it does something else."""

    def plan(self, body: Body, position: float, velocity: float) -> Iterator[Step]:
        """Yield the steps from there on. The last one has no end, else the servo lets go when it is over."""

    def presses(self, body: Body, position: float) -> float:
        """Return a number whose sign is the direction in which it leans on a stop at `position`."""

    def lean(self, body: Body, position: float) -> Step:
        """Return the step in which it does."""


@dataclass(frozen=True)
class Approach:
    """Go to `goal` with a trapezoidal profile, and stay there with a torque of at most `limit`."""

    goal: float
    speed: float
    acceleration: float
    limit: float = 1.0

    def plan(self, body: Body, position: float, velocity: float) -> Iterator[Step]:
        """Yield speeding up, going on, slowing down, and staying at the goal."""
        surge = min(self.acceleration, body.most_acceleration(self.limit))
        if surge > 0:
            yield from _trapezoid(position, velocity, self.goal, self.speed, surge)
        else:
            yield self.lean(body, position)

    def presses(self, body: Body, position: float) -> float:
        """Lean on a stop that is before the goal."""
        return self.goal - position if abs(self.goal - position) > STILL else 0.0

    def lean(self, body: Body, position: float) -> Step:
        """Stand at the torque limit until it lets go."""
        return _stall(position, copysign(self.limit, self.goal - position))


@dataclass(frozen=True)
class Turn:
    """Turn at `speed`, either way, without end."""

    speed: float
    acceleration: float
    limit: float = 1.0

    def plan(self, body: Body, position: float, velocity: float) -> Iterator[Step]:
        """Yield reaching the speed, and keeping it."""
        surge, change = min(self.acceleration, body.most_acceleration(self.limit)), self.speed - velocity
        if surge <= 0:
            yield self.lean(body, position)
            return
        if change:
            reaching = Step(abs(change) / surge, position, velocity, copysign(surge, change))
            yield reaching
            position, _ = reaching.after(reaching.duration)
        yield Step(inf, position, self.speed)

    def presses(self, body: Body, position: float) -> float:
        """Lean on a stop that is in the way."""
        return self.speed

    def lean(self, body: Body, position: float) -> Step:
        """Stand at the torque limit until it lets go."""
        return _stall(position, copysign(self.limit, self.speed))


@dataclass(frozen=True)
class Push:
    """Give a constant `torque`, against a counter-torque of `damping` for each rad/s."""

    torque: float
    damping: float

    def plan(self, body: Body, position: float, velocity: float) -> Iterator[Step]:
        """Yield short steps until it is at rest, or turns at a constant speed."""
        while abs(velocity) > CREEP or abs(self.presses(body, position)) > STICTION * body.friction:
            step = self._step(body, position, velocity)
            yield step
            position, velocity = step.after(step.duration)
        yield self.lean(body, position)

    def presses(self, body: Body, position: float) -> float:
        """Lean on a stop with what gravity leaves of the torque."""
        return self.torque - body.gravity * cos(position)

    def lean(self, body: Body, position: float) -> Step:
        """Go on pushing."""
        return Step(inf, position, 0.0, effort=self.torque)

    def _step(self, body: Body, position: float, velocity: float) -> Step:
        pull = self.presses(body, position)
        against = copysign(body.friction, velocity or pull) + self.damping * velocity
        surge = (pull - against) / body.inertia
        if not body.gravity and abs(surge) < STEADY:
            return Step(inf, position, velocity, effort=self.torque)
        stops = -velocity / surge if velocity * surge < 0 else inf
        return Step(min(GRAIN, stops), position, velocity, surge, self.torque)


LIMP = Push(0.0, BACKDRIVE)


@dataclass(frozen=True)
class Hand:
    """Be moved to `goal` by a person, and be held there; the servo does nothing."""

    goal: float
    speed: float = 1.0

    def plan(self, body: Body, position: float, velocity: float) -> Iterator[Step]:
        """Yield the way of the hand."""
        for step in _trapezoid(position, velocity, self.goal, self.speed, 10.0):
            yield step._replace(effort=0.0)

    def presses(self, body: Body, position: float) -> float:
        """Feel a stop that is before the goal."""
        return self.goal - position

    def lean(self, body: Body, position: float) -> Step:
        """Go no further."""
        return Step(inf, position, 0.0, effort=0.0)


def _stall(position: float, effort: float) -> Step:
    return Step(OVERLOADED_AFTER, position, 0.0, effort=effort, stalled=True)


def _trapezoid(position: float, velocity: float, goal: float, most: float, surge: float) -> Iterator[Step]:
    """Yield a trapezoidal way to `goal`, from any velocity; it turns back where it cannot stop in time."""
    way = goal - position
    if abs(way) <= STILL and abs(velocity) <= STILL:
        yield Step(inf, goal, 0.0)
        return
    side = copysign(1.0, way - velocity * abs(velocity) / (2 * surge))
    way, speed = way * side, velocity * side
    peak = min(sqrt(max(surge * way + speed * speed / 2, 0.0)), most)
    reaching = abs(peak - speed) / surge
    cruise = way - (peak + speed) / 2 * reaching - peak * peak / (2 * surge)
    phases = (
        (reaching, copysign(surge, peak - speed)),
        (max(cruise, 0.0) / peak if peak > 0 else 0.0, 0.0),
        (peak / surge, -surge),
    )
    for duration, acceleration in phases:
        if duration > 0:
            step = Step(duration, position, velocity, acceleration * side)
            yield step
            position, velocity = step.after(duration)
    yield Step(inf, goal, 0.0)
