"""A fake arm that picks and places by itself, for predictions: it takes no commands.

    python -m rtagent_drivers.arm mine.csv.gz     # writes a recording of it, ten minutes long

Its joints are those of the Bento Arm: shoulder, elbow, wrist rotation, wrist flexion, hand, and further ones that
sway along. They move from pose to pose with minimum jerk (Flash and Hogan 1985), a little otherwise in each cycle.
"""

from __future__ import annotations

import argparse
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import cos, exp, pi, sin, tanh
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import FREQUENCY, TIME, second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.recorded import record
from rtagent_drivers.tables import write_table

AMBIENT, HEATING, TIME_CONSTANT = 25.0, 100.0, 240.0
"""A joint's temperature tends to AMBIENT + HEATING · load² (°C), with this time constant (s)."""

NOISE = (0.002, 0.02, 0.01, 0.2)
"""Position, velocity, load and temperature are off by up to so much, each in its own unit."""

MOST_JOINTS = 32
MASK = (1 << 64) - 1


@dataclass(frozen=True)
class Joint:
    """A joint: how much of its full load its inertia takes (s²/rad), gravity at its worst, and friction."""

    name: str
    inertia: float
    gravity: float
    friction: float


JOINTS = (
    Joint("shoulder", 0.05, 0.0, 0.06),  # turns about the vertical: gravity does nothing
    Joint("elbow", 0.04, 0.35, 0.05),
    Joint("wrist_rotation", 0.01, 0.0, 0.04),
    Joint("wrist_flexion", 0.02, 0.12, 0.04),
    Joint("hand", 0.005, 0.0, 0.05),
)


class Pose(NamedTuple):
    """Where the named joints are to be (rad), how long the way takes (s), and what the hand carries (0 to 1)."""

    angles: tuple[float, ...]
    duration: float
    carried: float


CYCLE = (
    Pose((-0.9, 0.7, 0.0, 0.5, 0.2), 1.2, 0.0),  # above the object
    Pose((-0.9, 0.1, 0.0, 0.9, 0.2), 0.8, 0.0),  # down to it
    Pose((-0.9, 0.1, 0.0, 0.9, 1.0), 0.5, 0.0),  # grasp
    Pose((-0.9, 0.9, 0.0, 0.4, 1.0), 0.9, 1.0),  # lift
    Pose((0.8, 0.9, 0.9, 0.4, 1.0), 1.6, 1.0),  # over to the place
    Pose((0.8, 0.3, 0.9, 0.7, 1.0), 0.9, 1.0),  # down
    Pose((0.8, 0.3, 0.9, 0.7, 0.2), 0.5, 0.0),  # release
    Pose((0.0, 1.2, 0.0, 0.2, 0.2), 1.4, 0.0),  # home
    Pose((0.0, 1.2, 0.0, 0.2, 0.2), 0.6, 0.0),  # rest
)
VARIATION = (0.12, 0.05, 0.08, 0.05, 0.02)
"""Standard deviations (rad) of a pose's angles, from cycle to cycle."""


@dataclass(frozen=True)
class Move:
    """A way from pose to pose that begins at `start` (ns) and takes `duration` (s).

    Its joints are as warm as `temperatures` when it begins, and tend to `warmth` while it lasts (°C).
    """

    start: int
    duration: float
    origin: tuple[float, ...]
    target: tuple[float, ...]
    carried: float
    temperatures: tuple[float, ...]
    warmth: tuple[float, ...]

    def heated(self, elapsed: float) -> tuple[float, ...]:
        """Return the temperatures `elapsed` (s) after it began, by the first-order law."""
        cold = exp(-elapsed / TIME_CONSTANT)
        return tuple(
            final + (before - final) * cold for before, final in zip(self.temperatures, self.warmth, strict=True)
        )


class Motion(NamedTuple):
    """One joint's motion at one moment: rad, rad/s, and its load as a fraction of the full one."""

    position: float
    velocity: float
    load: float


class ArmWorld:
    """An arm of `joints` joints (1 to 32) that goes on picking and placing; its state is a function of time."""

    def __init__(self, joints: int = 5) -> None:
        if not 1 <= joints <= MOST_JOINTS:
            raise SpecError(f"joints is {joints}: an arm has 1 to {MOST_JOINTS}.")
        further = (Joint(f"joint_{number}", 0.02, 0.1, 0.04) for number in range(6, joints + 1))
        self._joints = (*JOINTS[:joints], *further)
        self.spec = DeviceSpec(
            sensors={name: spec for joint in self._joints for name, spec in _sensors(joint.name)}
        )

    def begin(self, now: int, rng: Generator) -> None:
        """Begin at home, cold; the cycles' variations follow from one number that is drawn from `rng`."""
        self._seed = int(rng.integers(1 << 63))
        self._cycles = 0
        home = self._angles(CYCLE[-1], (0.0,) * len(VARIATION))
        self._moves: list[Move] = []
        self._starts: list[int] = []
        self._add(now, CYCLE[-1].duration, home, home, 0.0, (AMBIENT,) * len(self._joints))

    def values(self, time: int) -> Values:
        """Return what the sensors measure at `time` (ns), noise included."""
        move = self._move(time)
        elapsed = (time - move.start) / second
        values: dict[str, float] = {}
        measured = zip(self._motions(move, elapsed), move.heated(elapsed), strict=True)
        for number, (motion, temperature) in enumerate(measured):
            name, noise = self._joints[number].name, noise_at(self._seed, time, number)
            values[f"{name}_position"] = motion.position + NOISE[0] * noise[0]
            values[f"{name}_velocity"] = motion.velocity + NOISE[1] * noise[1]
            values[f"{name}_load"] = min(max(motion.load + NOISE[2] * noise[2], -1.0), 1.0)
            values[f"{name}_temperature"] = temperature + NOISE[3] * noise[3]
        return values

    def command(self, now: int, command: Command) -> Command:
        """Take no command: it has no actuators."""
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: nothing calls for a reaction."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return when the next move begins."""
        self._move(now)
        return self._starts[bisect_right(self._starts, now)]

    def make_safe(self, now: int) -> None:
        """Do nothing: what it does by itself is part of the world."""

    def save(self) -> Saved:
        """Return nothing: all follows from when and from what it began."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""

    def _angles(self, pose: Pose, changes: Sequence[float]) -> tuple[float, ...]:
        named = [angle + change for angle, change in zip(pose.angles, changes, strict=True)]
        swaying = [0.6 * sin(3.0 * named[0] + number) for number in range(len(JOINTS), len(self._joints))]
        return tuple((named + swaying)[: len(self._joints)])

    def _move(self, time: int) -> Move:
        """Return the move at `time`, adding cycles until one is known that begins later."""
        while self._starts[-1] <= time:
            for pose, angles, duration in self._next_cycle():
                last = self._moves[-1]
                start = last.start + round(last.duration * second)
                self._add(start, duration, last.target, angles, pose.carried, last.heated(last.duration))
        return self._moves[bisect_right(self._starts, time) - 1]

    def _add(
        self,
        start: int,
        duration: float,
        origin: tuple[float, ...],
        target: tuple[float, ...],
        carried: float,
        temperatures: tuple[float, ...],
    ) -> None:
        """Add a move; what its joints tend to follows from their mean load² in it."""
        move = Move(start, duration, origin, target, carried, temperatures, temperatures)
        moments = [self._motions(move, duration * part) for part in (0.125, 0.375, 0.625, 0.875)]
        squares = [[motion.load**2 for motion in moment] for moment in moments]
        warmth = tuple(AMBIENT + HEATING * sum(each) / len(each) for each in zip(*squares, strict=True))
        self._moves.append(replace(move, warmth=warmth))
        self._starts.append(start)

    def _next_cycle(self) -> Iterator[tuple[Pose, tuple[float, ...], float]]:
        """Yield the poses of the next cycle; those at one place share their variation."""
        rng = np.random.default_rng((self._seed, self._cycles))
        self._cycles += 1
        pick, place, home = rng.normal(0.0, VARIATION, (3, len(VARIATION))).clip(-0.3, 0.3).tolist()
        paces = rng.uniform(0.85, 1.15, len(CYCLE)).tolist()
        for pose, change, pace in zip(CYCLE, (pick,) * 4 + (place,) * 3 + (home,) * 2, paces, strict=True):
            yield pose, self._angles(pose, change), pose.duration * pace

    def _motions(self, move: Move, elapsed: float) -> list[Motion]:
        """Return the motion of every joint, `elapsed` (s) after the move began."""
        way, pace, surge = minimum_jerk(elapsed / move.duration)
        pace, surge = pace / move.duration, surge / move.duration**2
        motions = []
        lift = 0.0
        for joint, origin, target in zip(self._joints, move.origin, move.target, strict=True):
            span = target - origin
            position, velocity = origin + span * way, span * pace
            lift += position if joint.gravity else 0.0
            load = joint.inertia * span * surge + joint.friction * tanh(velocity / 0.1) + 0.02 * velocity
            load += joint.gravity * cos(lift) * (1.0 + 0.5 * move.carried)
            load += 0.3 * move.carried if joint.name == "hand" else 0.0
            motions.append(Motion(position, velocity, load))
        return motions


def minimum_jerk(time: float) -> tuple[float, float, float]:
    """Return position, velocity and acceleration of the minimum-jerk way from 0 to 1 at `time`, 0 to 1."""
    return (
        time**3 * (10.0 - 15.0 * time + 6.0 * time**2),
        30.0 * time**2 * (1.0 - time) ** 2,
        60.0 * time * (1.0 - time) * (1.0 - 2.0 * time),
    )


def noise_at(seed: int, time: int, joint: int) -> tuple[float, float, float, float]:
    """Return four numbers from -1 to 1 that depend on nothing else: SplitMix64 (Steele, Lea and Flood 2014)."""
    mixed = (seed + (time * MOST_JOINTS + joint + 1) * 0x9E3779B97F4A7C15) & MASK
    mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & MASK
    mixed ^= mixed >> 31
    half = 32767.5
    return (
        (mixed & 0xFFFF) / half - 1.0,
        (mixed >> 16 & 0xFFFF) / half - 1.0,
        (mixed >> 32 & 0xFFFF) / half - 1.0,
        (mixed >> 48) / half - 1.0,
    )


def _sensors(joint: str) -> Iterator[tuple[str, Spec]]:
    yield f"{joint}_position", Spec(unit="rad", low=-pi / 2, high=pi / 2)
    yield f"{joint}_velocity", Spec(unit="rad/s", low=-5.0, high=5.0)
    yield f"{joint}_load", Spec(low=-1.0, high=1.0)
    yield f"{joint}_temperature", Spec(unit="°C", low=AMBIENT - 5.0, high=90.0)


def arm(*, joints: int = 5, sampling: Sampling | None = None, faults: Faults | None = None) -> FakeDevice:
    """A fake arm that picks and places by itself, as predictions want it: it takes no commands."""
    return FakeDevice(ArmWorld(joints), sampling or Sampling(rate=30.0), faults)


def main(argv: Sequence[str] | None = None) -> None:
    """Write a recording of the arm to a file."""
    parser = argparse.ArgumentParser(prog="python -m rtagent_drivers.arm", description=main.__doc__)
    parser.add_argument("file", type=Path, help="where to: its name ends in .csv, .csv.gz or .npz")
    parser.add_argument("--duration", type=TIME.parse, default="10min", help="such as 10min")
    parser.add_argument("--rate", type=FREQUENCY.parse, default="30Hz", help="rows a second, such as 30Hz")
    parser.add_argument("--joints", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(argv)
    try:
        write_table(record(ArmWorld(given.joints), given.duration, given.rate, given.seed), given.file)
    except (SpecError, OSError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
