"""One joint's motion as a function of time: pieces of constant acceleration, each planned when a drive begins.

Positions are in rad, velocities in rad/s, loads in fractions of the servo's full load, temperatures in °C, times in
ns. Nothing here asks what time it is; a state may be asked for in any order.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from math import ceil, exp
from typing import Any, NamedTuple

from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.units import second
from rtagent_drivers.dynamixel.steps import FOREVER, LIMP, Body, Drive, Step

AMBIENT, HEATING, COOLING_TIME = 25.0, 100.0, 240.0
"""A servo's temperature tends to AMBIENT + HEATING · load² (°C), with this time constant (s)."""

REMEMBERED = 4096
"""Pieces that are kept; of older ones nothing is known any more."""

STATE = ("_blocked", "_followed", "_since", "_let_go")
"""What is saved of a motion as it is."""


class State(NamedTuple):
    """A joint at one moment; `overloaded` once its servo has let go for having stood at its torque limit."""

    position: float
    velocity: float
    load: float
    temperature: float
    overloaded: bool


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

    def save(self) -> Saved:
        """Return the pieces, and from what the last ones follow; the drive is not among it."""
        pieces = [[piece.start, piece.end, *piece.step, piece.temperature, piece.warmth] for piece in self._pieces]
        return {"pieces": pieces} | save_fields(self, STATE)

    def restore(self, saved: Saved, drive: Drive) -> None:
        """Take what `save` returned of a motion under this drive."""
        self._drive, self._blocked = drive, saved["_blocked"]
        self._starts, self._pieces = [], []
        self._follow(*saved["_followed"])
        while self._since < saved["_since"]:
            self._append_next()
        self._pieces = [_restored(*piece) for piece in saved["pieces"]]
        self._starts = [piece.start for piece in self._pieces]
        restore_fields(self, STATE, saved)

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
        self._followed, self._since = [now, position, velocity, temperature], 0
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
        self._since += 1
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


def _restored(start: int, end: int | None, *numbers: Any) -> _Piece:
    *step, temperature, warmth = numbers
    return _Piece(start, end, Step(*step), temperature, warmth)


def _piece(start: int, step: Step, temperature: float, body: Body) -> _Piece:
    """Return a step as a piece of time; it heats by the mean square of the load in it."""
    endless = step.duration > FOREVER
    moments = (0.0,) if endless else (0.25 * step.duration, 0.75 * step.duration)
    end = None if endless else start + ceil(step.duration * second)
    squares = [_load(step, body, *step.after(moment)) ** 2 for moment in moments]
    return _Piece(start, end, step, temperature, AMBIENT + HEATING * sum(squares) / len(squares))


def _load(step: Step, body: Body, position: float, velocity: float) -> float:
    load = body.needed(position, velocity, step.acceleration) if step.effort is None else step.effort
    return min(max(load, -1.0), 1.0)


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
