"""What may be on a board's pins: a hand whose joints follow its servos, and a glove that makes gestures.

All is a function of time; nothing asks what time it is. Readings are those of an AVR's converter, 0 to 1023.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from typing import NamedTuple, Protocol

import numpy as np
from numpy.random import Generator

from rtagent.saving import Saved
from rtagent.units import ms, second
from rtagent_drivers.arduino.layouts import HANDI_PINS
from rtagent_drivers.arduino.messages import LARGEST_READING

NOISE = 2
"""Readings are off by up to so much."""

FASTEST = 1.5
"""A hobby servo goes through its range so often in a second."""

KEPT_WAYS = 64
LEAST, MOST = 150, 870
"""What a potentiometer or a bend sensor reads at its ends."""

CONTACT = 0.55
"""Where in its range a finger meets an object."""

STIFFNESS = 2.0
"""How much of its range a force sensor shows for a servo that is a whole range beyond contact."""

MASK = (1 << 64) - 1


class Body(Protocol):
    """What is on the pins of a board; times in ns."""

    def begin(self, now: int, rng: Generator) -> None:
        """Begin anew at `now`, all that is random drawn from `rng`."""

    def reading(self, pin: str, time: int) -> int:
        """Return what is read at a pin ("A3", "2"), or of a field that is no pin's, at `time`."""

    def turn(self, now: int, servo: int, goal: float | None, speed: float = FASTEST) -> None:
        """Send a servo (by its number) to a fraction of its range, at ranges a second; None: it goes limp."""

    def save(self) -> Saved:
        """Return what has become of it since it began."""

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""


class Rhythm:
    """Something that is now so and now otherwise, for times drawn beforehand, over and over."""

    def __init__(self, now: int, spans: Sequence[int]) -> None:
        self._began = now
        self._ends = list(accumulate(spans))

    def at(self, time: int) -> tuple[int, int]:
        """Return which span it is, and how long ago (ns) that began."""
        since = (time - self._began) % self._ends[-1]
        number = bisect_right(self._ends, since)
        return number, since - (self._ends[number - 1] if number else 0)


class Way(NamedTuple):
    """The motion of a servo from a time on: from a place to a goal; both fractions of its range."""

    begins: int
    start: float
    goal: float
    speed: float
    limp: bool = False

    def at(self, time: int) -> float:
        """Return where it would be if nothing were in its way."""
        far = self.speed * max(0, time - self.begins) / second
        return self.start + min(max(self.goal - self.start, -far), far)


class Digit:
    """A servo with the joint that it moves."""

    def __init__(self, now: int) -> None:
        self._ways = [Way(now, 0.0, 0.0, FASTEST, limp=True)]

    def turn(self, now: int, goal: float | None, speed: float) -> None:
        """Go to `goal`; None: stay limp where it is."""
        at = self.way(now).at(now)
        self._ways = self._ways[-KEPT_WAYS:]
        self._ways.append(Way(now, at, at if goal is None else goal, min(speed, FASTEST), goal is None))

    def save(self) -> Saved:
        """Return its ways."""
        return {"ways": [list(way) for way in self._ways]}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self._ways = [Way(*way) for way in saved["ways"]]

    def way(self, time: int) -> Way:
        """Return the motion that it was in at `time`."""
        return next((way for way in reversed(self._ways) if way.begins <= time), self._ways[0])


class Hand:
    """A hand of six digits in which something lies now and then; its button is pressed now and then, too.

    Its digits follow their servos, or with `grasps` close and open by themselves.
    """

    CLOSING = 600 * ms

    def __init__(self, *, grasps: bool = False) -> None:
        self._grasps = grasps
        self.begin(0, np.random.default_rng(0))

    def begin(self, now: int, rng: Generator) -> None:
        """Open the hand, and draw when something lies in it and when its button is pressed."""
        self._digits = [Digit(now) for _ in range(6)]
        self._object = Rhythm(now, _spans(rng, 2 * second, 4 * second))
        self._grasp = Rhythm(now, _spans(rng, 1 * second, 3 * second))
        self._button = Rhythm(now, _alternating(rng, (2 * second, 6 * second), (200 * ms, 500 * ms)))

    def turn(self, now: int, servo: int, goal: float | None, speed: float = FASTEST) -> None:
        """Send the servo of a digit to a fraction of its range."""
        self._digits[servo].turn(now, goal, speed)

    def reading(self, pin: str, time: int) -> int:
        """Return what the sensor on a pin reads; a pressed button reads 0 at the pin, as its pull-up has it."""
        field = FIELDS.get(pin, pin)
        if field == "M":
            pressed = self._button.at(time)[0] % 2
            return int(not pressed) if pin.isdigit() else pressed
        if field[:1] == "D" and field != "D1I":
            return _noisy(LEAST + (MOST - LEAST) * self._place(int(field[1]), time), field, time)
        if field.startswith("FSR"):
            return _noisy(LARGEST_READING * self._force(int(field[3:]), time), field, time)
        return 0

    def save(self) -> Saved:
        """Return the ways of its digits; the rest follows from when and from what it began."""
        return {"digits": [digit.save() for digit in self._digits]}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        for digit, way in zip(self._digits, saved["digits"], strict=True):
            digit.restore(way)

    def _place(self, digit: int, time: int) -> float:
        place, _ = self._aim(digit, time)
        return min(place, CONTACT) if self._holds(time) else place

    def _force(self, digit: int, time: int) -> float:
        place, limp = self._aim(digit, time)
        return 0.0 if limp or not self._holds(time) else min(1.0, STIFFNESS * max(0.0, place - CONTACT))

    def _aim(self, digit: int, time: int) -> tuple[float, bool]:
        """Return where a digit would be if nothing were in its way, and whether it is limp."""
        if not self._grasps:
            way = self._digits[digit].way(time)
            return way.at(time), way.limp
        number, since = self._grasp.at(time)
        closed = minimum_jerk(since / self.CLOSING)
        return closed if number % 2 else 1.0 - closed, False

    def _holds(self, time: int) -> bool:
        return bool(self._object.at(time)[0] % 2)


class Glove:
    """A glove of six bend sensors, worn by a hand that goes from gesture to gesture with minimum jerk."""

    GESTURES = 64
    MOVING = 400 * ms

    def __init__(self) -> None:
        self.begin(0, np.random.default_rng(0))

    def begin(self, now: int, rng: Generator) -> None:
        """Draw the gestures, and how long each takes."""
        self._bends = rng.random((self.GESTURES, 6))
        self._gestures = Rhythm(now, [int(each) for each in rng.integers(second, 2 * second, self.GESTURES)])

    def turn(self, now: int, servo: int, goal: float | None, speed: float = FASTEST) -> None:
        """Do nothing: there are no servos."""

    def reading(self, pin: str, time: int) -> int:
        """Return what a bend sensor reads; pins without one read 0."""
        if pin not in BENDS:
            return 0
        finger = BENDS.index(pin)
        number, since = self._gestures.at(time)
        share = minimum_jerk(since / self.MOVING)
        bend = (1.0 - share) * self._bends[number - 1, finger] + share * self._bends[number, finger]
        return _noisy(LEAST + (MOST - LEAST) * bend, pin, time)

    def save(self) -> Saved:
        """Return nothing: all follows from when and from what it began."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""


BODIES: Mapping[str, Callable[[], Body]] = {
    "hand": Hand,
    "grasping": partial(Hand, grasps=True),
    "glove": Glove,
}
"""What may be on the pins, by the names that settings give it."""

FIELDS = {pin: field for field, pin in HANDI_PINS.items()}
BENDS = tuple(f"A{number}" for number in range(6))


def minimum_jerk(done: float) -> float:
    """Return which part of its way a limb has gone after a part of its time (Flash and Hogan 1985)."""
    done = min(1.0, done)
    return done**3 * (10.0 - 15.0 * done + 6.0 * done**2)


def _spans(rng: Generator, least: int, most: int) -> list[int]:
    return [int(each) for each in rng.integers(least, most, 64)]


def _alternating(rng: Generator, first: tuple[int, int], second_: tuple[int, int]) -> list[int]:
    pairs = zip(_spans(rng, *first), _spans(rng, *second_), strict=True)
    return [span for pair in pairs for span in pair]


def _noisy(reading: float, pin: str, time: int) -> int:
    """Return a reading with noise that is a function of time."""
    mixed = (time * 0x9E3779B97F4A7C15 + sum(pin.encode()) * 0xBF58476D1CE4E5B9) & MASK
    mixed = (mixed ^ mixed >> 29) * 0x94D049BB133111EB & MASK
    noise = (mixed >> 40) % (2 * NOISE + 1) - NOISE
    return min(max(round(reading) + noise, 0), LARGEST_READING)
