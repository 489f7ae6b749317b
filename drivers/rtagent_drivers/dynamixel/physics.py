"""One joint's motion as a function of time: pieces of constant acceleration, each planned when a drive begins.

Positions are in rad, velocities in rad/s, loads and torques in fractions of the servo's full load, temperatures in
°C, times in ns. Nothing here asks what time it is; a state may be asked for in any order.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from math import ceil, copysign, cos, exp, inf, isinf, sqrt, tanh
from typing import NamedTuple, Protocol

from rtagent.units import second

AMBIENT, HEATING, COOLING_TIME = 25.0, 100.0, 240.0
"""A servo's temperature tends to AMBIENT + HEATING · load² (°C), with this time constant (s)."""

OVERLOADED_AFTER = 1.0
"""A servo that stands still at its torque limit lets go after so long (s)."""

GRAIN = 0.005
"""What moves freely is followed in pieces so long (s)."""

BACKDRIVE = 0.4
"""Damping of a gearbox that is turned from outside, per rad/s: a limp arm sinks, it does not drop."""

LUBRICATION = 0.02
"""Load that one rad/s takes."""

REMEMBERED = 4096
"""Pieces that are kept; of older ones nothing is known any more."""

STILL = 1e-9
"""Ways (rad) and speeds (rad/s) too small to matter."""
CREEP = 1e-3
"""Speed (rad/s), and load beyond that of friction, at which what moves freely comes to rest."""
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

    def needed(self, position: float, velocity: float, acceleration: float) -> float:
        """Return the load that a motion takes."""
        turning = self.friction * tanh(velocity / 0.1) + LUBRICATION * velocity
        return self.inertia * acceleration + self.gravity * cos(position) + turning

    def most_acceleration(self, limit: float) -> float:
        """Return what acceleration (rad/s²) is left to a torque `limit` at the worst angle; 0 or less: none."""
        return (limit - abs(self.gravity) - self.friction) / self.inertia


class State(NamedTuple):
    """A joint at one moment; `overloaded` once its servo has let go for having stood at its torque limit."""

    position: float
    velocity: float
    load: float
    temperature: float
    overloaded: bool


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
        return time if time < self.duration else None

    def _returns(self, speed: float, surge: float) -> float | None:
        """Return when one that begins at the end and goes inwards is back there."""
        time = -2.0 * speed / surge if surge > 0 else inf
        return time if time < self.duration else None


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
        while abs(velocity) > CREEP or abs(self.presses(body, position)) > body.friction + CREEP:
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


class Motion:
    """A joint in motion: it is driven from moments on, and its state follows for every time since `start` (ns)."""

    def __init__(self, body: Body, position: float, start: int, drive: Drive = LIMP) -> None:
        self._body, self._drive = body, drive
        self._blocked = False
        self._starts: list[int] = []
        self._pieces: list[_Piece] = []
        self._follow(start, position, 0.0, AMBIENT)

    def at(self, time: int) -> State:
        """Return the state at `time`; before the start it is that at the start."""
        return self._piece(time).at(time, self._body)

    def drive(self, now: int, drive: Drive) -> None:
        """Let `drive` act from `now` on, which is no earlier than when the last one began."""
        self._drive = drive
        self._anew(now)

    def block(self, now: int, blocked: bool) -> None:
        """Hold the joint fast where it is, or let it go again."""
        self._blocked = blocked
        self._anew(now)

    def lets_go(self) -> int | None:
        """Return when (ns) its servo lets go, or has let go, under the drive that it has; None if it does not."""
        while self._pieces[-1].leads_on:
            self._append_next()
        last = self._pieces[-1]
        return last.end if last.step.stalled else self._let_go

    def _anew(self, now: int) -> None:
        state = self.at(now)
        kept = bisect_right(self._starts, now - 1)
        del self._starts[kept:], self._pieces[kept:]
        self._follow(now, state.position, state.velocity, state.temperature)

    def _follow(self, now: int, position: float, velocity: float, temperature: float) -> None:
        body = replace(self._body, low=position, high=position) if self._blocked else self._body
        self._coming = _steps(self._drive, body, position, velocity)
        self._let_go: int | None = None
        self._append(now, temperature)

    def _append_next(self) -> None:
        last = self._pieces[-1]
        assert last.end is not None, "nothing comes after what has no end"
        self._let_go = last.end if last.step.stalled else self._let_go
        self._append(last.end, last.temperature_at(last.end))

    def _append(self, start: int, temperature: float) -> None:
        self._pieces.append(_piece(start, next(self._coming), temperature, self._body))
        self._starts.append(start)
        if len(self._pieces) > REMEMBERED:
            del self._starts[: REMEMBERED // 2], self._pieces[: REMEMBERED // 2]

    def _piece(self, time: int) -> _Piece:
        while (end := self._pieces[-1].end) is not None and end <= time:
            self._append_next()
        return self._pieces[max(0, bisect_right(self._starts, time) - 1)]


@dataclass(frozen=True, slots=True)
class _Piece:
    """A step in time: it ends at `end` (ns), and the servo, `temperature` warm at first, tends to `warmth`."""

    start: int
    end: int | None
    step: Step
    temperature: float
    warmth: float

    @property
    def leads_on(self) -> bool:
        """Whether it is a stretch of a planned way, after which another follows soon."""
        return self.end is not None and self.step.effort is None

    def at(self, time: int, body: Body) -> State:
        elapsed = max(0, time - self.start) / second
        position, velocity = self.step.after(elapsed)
        load = _load(self.step, body, position, velocity)
        return State(position, velocity, load, self.temperature_at(time), self.step.overloaded)

    def temperature_at(self, time: int) -> float:
        cold = exp(-max(0, time - self.start) / second / COOLING_TIME)
        return self.warmth + (self.temperature - self.warmth) * cold


def _piece(start: int, step: Step, temperature: float, body: Body) -> _Piece:
    """Return a step as a piece of time; it heats by the mean square of the load in it."""
    endless = isinf(step.duration)
    moments = (0.0,) if endless else (0.25 * step.duration, 0.75 * step.duration)
    end = None if endless else start + ceil(step.duration * second)
    squares = [_load(step, body, *step.after(moment)) ** 2 for moment in moments]
    return _Piece(start, end, step, temperature, AMBIENT + HEATING * sum(squares) / len(squares))


def _load(step: Step, body: Body, position: float, velocity: float) -> float:
    load = body.needed(position, velocity, step.acceleration) if step.effort is None else step.effort
    return min(max(load, -1.0), 1.0)


def _stall(position: float, effort: float) -> Step:
    return Step(OVERLOADED_AFTER, position, 0.0, effort=effort, stalled=True)


def _steps(drive: Drive, body: Body, position: float, velocity: float) -> Iterator[Step]:
    """Yield the steps of a drive between the joint's stops, and those of a limp joint once the servo lets go."""
    let_go = yield from _between_stops(drive, body, position, velocity)
    for step in _between_stops(LIMP, body, let_go, 0.0):
        yield step._replace(overloaded=True)


def _between_stops(drive: Drive, body: Body, position: float, velocity: float) -> Generator[Step, None, float]:
    """Yield the steps of a drive, stopped where the joint meets its stops; return where the servo lets go."""
    while True:
        for step in drive.plan(body, position, velocity):
            met = _meets(step, body)
            if met is None:
                position = step.position
                yield step
                continue
            time, end, outwards = met
            if time > 0:
                yield step._replace(duration=time)
            position, velocity = end, 0.0
            break
        else:
            return position
        if drive.presses(body, position) * outwards > 0:
            yield drive.lean(body, position)
            return position


def _meets(step: Step, body: Body) -> tuple[float, float, float] | None:
    """Return when a step meets a stop, where that is, and its direction; None where it does not."""
    met = ((step.leaves(end, outwards), end, outwards) for end, outwards in ((body.low, -1.0), (body.high, 1.0)))
    return min(((time, end, outwards) for time, end, outwards in met if time is not None), default=None)


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
