"""What may be on a board's pins: a hand that follows its servos, or hand and glove of the grasping experiment.

All is a function of time; nothing asks what time it is. Readings are those of an AVR's converter, 0 to 1023.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.experience import FloatArray
from rtagent.saving import Saved
from rtagent.streams import shared
from rtagent.units import ms, second
from rtagent_drivers.arduino.layouts import HANDI_PINS
from rtagent_drivers.arduino.messages import LARGEST_READING
from rtagent_drivers.grasping.assumed import JOINTS
from rtagent_drivers.grasping.hands import Gestures, Grasp
from rtagent_drivers.grasping.noise import bits, salt, salts
from rtagent_drivers.grasping.session import EXPERIMENT, Session, Times

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


@runtime_checkable
class Scanning(Protocol):
    """A body that can be asked for many moments at once."""

    def scan(self, times: Times) -> Mapping[str, Times]:
        """Return what is read at these times (ns), shape (n,), by the names of pins and of fields."""


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
    """A hand whose six digits follow their servos; now and then something lies in it, or its button is pressed."""

    def __init__(self) -> None:
        self.begin(0, np.random.default_rng(0))

    def begin(self, now: int, rng: Generator) -> None:
        """Open the hand, and draw when something lies in it and when its button is pressed."""
        self._digits = [Digit(now) for _ in range(6)]
        self._object = Rhythm(now, _spans(rng, 2 * second, 4 * second))
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
            return _reading(_flexed(self._place(int(field[1]), time)), field, time)
        if field.startswith("FSR"):
            return _reading(LARGEST_READING * self._force(int(field[3:]), time), field, time)
        return 0

    def save(self) -> Saved:
        """Return the ways of its digits; the rest follows from when and from what it began."""
        return {"digits": [digit.save() for digit in self._digits]}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        for digit, way in zip(self._digits, saved["digits"], strict=True):
            digit.restore(way)

    def _place(self, digit: int, time: int) -> float:
        place = self._digits[digit].way(time).at(time)
        return min(place, CONTACT) if self._holds(time) else place

    def _force(self, digit: int, time: int) -> float:
        way = self._digits[digit].way(time)
        if way.limp or not self._holds(time):
            return 0.0
        return min(1.0, STIFFNESS * max(0.0, way.at(time) - CONTACT))

    def _holds(self, time: int) -> bool:
        return bool(self._object.at(time)[0] % 2)


class Part(Protocol):
    """Who takes part in the grasping experiment, with a board."""

    def scan(self, times: Times) -> Mapping[str, Times]:
        """Return what is read at these times since the experiment began, by the names of pins and of fields."""


class Modelled:
    """A body of the grasping experiment (`rtagent_drivers.grasping`): it moves by itself."""

    def __init__(self, make: Callable[[Session], Part]) -> None:
        self._make = make
        self.begin(0, np.random.default_rng(0))

    def begin(self, now: int, rng: Generator) -> None:
        """Begin the experiment; bodies and cameras whose streams are of one episode meet the same trials."""
        self._began, self._scanned = now, now - 1
        self._part = self._make(Session(shared(rng, EXPERIMENT)))

    def turn(self, now: int, servo: int, goal: float | None, speed: float = FASTEST) -> None:
        """Do nothing: what it does is the experiment's."""

    def reading(self, pin: str, time: int) -> int:
        """Return what is read at a pin, 0 where nothing is."""
        if time != self._scanned:
            self._readings, self._scanned = self.scan(np.array([time])), time
        return int(self._readings[pin][0]) if pin in self._readings else 0

    def scan(self, times: Times) -> Mapping[str, Times]:
        """Return what is read at these times (ns), shape (n,), by the names of pins and of fields."""
        return self._part.scan(times - self._began)

    def save(self) -> Saved:
        """Return nothing: all follows from when and from what it began."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""


class GraspingHand:
    """The hand that closes around each object; its button is pressed when a trial begins."""

    FIELDS = (*JOINTS, *(f"FSR{number}" for number in range(1, 6)))

    def __init__(self, session: Session) -> None:
        self._session, self._grasp, self._salts = session, Grasp(session), salts(self.FIELDS)

    def scan(self, times: Times) -> Mapping[str, Times]:
        """Return what its sensors read, as fields of the older sketch and as pins of its Mega."""
        exact = np.zeros((len(self.FIELDS), len(times)))
        exact[: len(JOINTS)] = _flexed(self._grasp.joints(times))
        exact[len(JOINTS)] = LARGEST_READING * self._grasp.thumb_force(times)
        found = dict(zip(self.FIELDS, _readings(exact, times, self._salts), strict=True))
        pressed = self._session.pressed(times).astype(np.int64)
        pins = {HANDI_PINS[field]: readings for field, readings in found.items()}
        return found | pins | {"M": pressed, HANDI_PINS["M"]: 1 - pressed}


class Glove:
    """A glove of six bend sensors, worn by who makes a gesture for each object that the hand holds."""

    def __init__(self, session: Session) -> None:
        self._gestures, self._salts = Gestures(session), salts(BENDS)

    def scan(self, times: Times) -> Mapping[str, Times]:
        """Return what its sensors read."""
        exact = _flexed(self._gestures.bends(times))
        return dict(zip(BENDS, _readings(exact, times, self._salts), strict=True))


BODIES: Mapping[str, Callable[[], Body]] = {
    "hand": Hand,
    "grasping": partial(Modelled, GraspingHand),
    "glove": partial(Modelled, Glove),
}
"""What may be on the pins, by the names that settings give it."""

FIELDS = {pin: field for field, pin in HANDI_PINS.items()}
BENDS = tuple(f"A{number}" for number in range(6))


def _spans(rng: Generator, least: int, most: int) -> list[int]:
    return [int(each) for each in rng.integers(least, most, 64)]


def _alternating(rng: Generator, first: tuple[int, int], second_: tuple[int, int]) -> list[int]:
    pairs = zip(_spans(rng, *first), _spans(rng, *second_), strict=True)
    return [span for pair in pairs for span in pair]


def _flexed(place: Any) -> Any:
    """Return what a potentiometer reads at a fraction of its range."""
    return LEAST + (MOST - LEAST) * place


def _reading(exact: float, field: str, time: int) -> int:
    """Return what a converter reads, noise included."""
    noise = int(bits(time, salt(field))) % (2 * NOISE + 1) - NOISE
    return min(max(round(exact) + noise, 0), LARGEST_READING)


def _readings(exact: FloatArray, times: Times, salted: NDArray[np.uint64]) -> Times:
    """Return what converters read at each of these times, shape (channels, n)."""
    noise = np.int64(bits(times, salted) % (2 * NOISE + 1)) - NOISE
    found: Times = np.minimum(np.maximum(np.rint(exact).astype(np.int64) + noise, 0), LARGEST_READING)
    return found
