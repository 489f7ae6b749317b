"""The trials of the grasping experiment: which object comes when, and what follows (thesis, section 5.2.1).

What the text says is a constant here with its place in the text; what it does not say is in `assumed.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.experience import FloatArray
from rtagent.units import ms, second
from rtagent_drivers.grasping import assumed

Times = NDArray[np.int64]
"""In ns."""
Numbers = NDArray[np.int64]


class Thing(NamedTuple):
    """An object: its colour, whether it is a stepped cylinder, the fingers put down for it, and its trials."""

    colour: str
    stepped: bool
    gesture: tuple[str, ...]
    trials: int


THINGS = (
    Thing("green", False, ("middle", "ring", "pinky"), 31),
    Thing("orange", True, ("ring", "pinky"), 33),
    Thing("green", True, ("pinky",), 33),
    Thing("orange", False, (), 34),
)
"""Figure 5.1's table, and how often each was presented."""

FINGERS = ("thumb", "index", "middle", "ring", "pinky", "thumb rotation")
"""What the glove's six sensors measure, in their order."""

CLOSES, RELEASES, TRIAL = 3 * second, 6 * second, 9 * second
"""Since the button was pressed: three seconds to the grasp, three of grasp, three until the trial ends."""
PRESSED = 300 * ms

EXPERIMENT = "grasping"
"""The name of the random stream that all devices of the experiment have in common."""


class Session:
    """The recorded trials in random order, one after the other, over and over.

    They were recorded object by object; what drifts follows that order, so that it jumps where trials meet.
    All times are in ns since the session began, arrays of shape (n,).
    """

    def __init__(self, rng: Generator) -> None:
        recorded = np.repeat(np.arange(len(THINGS)), [thing.trials for thing in THINGS])
        order = rng.permutation(len(recorded))
        self.things: Numbers = recorded[order]
        count = len(order)
        self.drift: FloatArray = np.cumsum(rng.normal(0.0, 1.0, count))[order]
        self.stepped = np.array([thing.stepped for thing in THINGS])[self.things]
        self.green = np.array([thing.colour == "green" for thing in THINGS])[self.things]
        self.enters = _times(rng, CLOSES - assumed.ENTERS_BEFORE, assumed.ENTERS_SPREAD, count)
        self.leaves = _times(rng, RELEASES + assumed.LEAVES_AFTER, assumed.LEAVES_SPREAD, count)
        self._seeds = rng.integers(1 << 62, size=3)

    def __len__(self) -> int:
        """Return how many trials there are before the first comes again."""
        return len(self.things)

    @property
    def hand_rng(self) -> Generator:
        """What is random of the hand that grasps is drawn from it, each time the same."""
        return np.random.default_rng(self._seeds[0])

    @property
    def glove_rng(self) -> Generator:
        """What is random of the hand in the glove is drawn from it."""
        return np.random.default_rng(self._seeds[1])

    @property
    def view_rng(self) -> Generator:
        """What is random of what the camera sees is drawn from it."""
        return np.random.default_rng(self._seeds[2])

    def at(self, times: Times) -> tuple[Numbers, Times]:
        """Return which trial it is at these times, and how long ago (ns) that began."""
        number, since = np.divmod(times, TRIAL)
        return number % len(self), since

    def pressed(self, times: Times) -> NDArray[np.bool_]:
        """Return whether the button is pressed."""
        return self.at(times)[1] < PRESSED

    def entries(self, after: int, until: int) -> list[int]:
        """Return when objects are brought with after < time <= until."""
        trials = range(max(0, after // TRIAL), until // TRIAL + 1)
        times = [trial * TRIAL + int(self.enters[trial % len(self)]) for trial in trials]
        return [time for time in times if after < time <= until]

    def next_change(self, now: int) -> int:
        """Return when, after `now`, an object is next brought, held, let go or taken away."""
        trial = max(0, now // TRIAL)
        times = [each * TRIAL + time for each in (trial, trial + 1) for time in self._moments(each % len(self))]
        return min(time for time in times if time > now)

    def _moments(self, trial: int) -> tuple[int, ...]:
        return int(self.enters[trial]), CLOSES, RELEASES, int(self.leaves[trial])


def _times(rng: Generator, mean: int, spread: int, count: int) -> Times:
    """Return times that lie around a mean, no farther than two and a half spreads."""
    return mean + np.rint(spread * np.clip(rng.normal(size=count), -2.5, 2.5)).astype(np.int64)


def share(since: Times, begins: Times | int, takes: FloatArray | float) -> FloatArray:
    """Return which part of a movement is done: that of a limb with minimum jerk (Flash and Hogan 1985)."""
    done = np.minimum(np.maximum((since - begins) / takes, 0.0), 1.0)
    moved: FloatArray = done**3 * (10.0 - 15.0 * done + 6.0 * done**2)
    return moved
