"""What the arm does in a trial (thesis, section 4.3), and what its servos go through.

It begins at one end of its shoulder's rotation, closes its gripper around an object, lifts its elbow while it
turns its shoulder towards the place that belongs to the object's weight, lowers its elbow, opens the gripper, and
returns. The wrist, of which the thesis says nothing, is held; or it keeps the hand level, and turns the object as
that is lowered. Joints move with minimum jerk (Flash and Hogan 1985); speeds, pauses and ends of ways are a little
otherwise each time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.experience import FloatArray
from rtagent_drivers.sorting.dynamics import torques
from rtagent_drivers.sorting.servos import MX_28, MX_64, MX_106, STIFFNESS, Drives

BoolArray = NDArray[np.bool_]

JOINTS = ("shoulder", "elbow", "wrist_rotation", "wrist_flexion", "hand")
SHOULDER, ELBOW, ROTATION, FLEXION, HAND = range(5)
MOTORS = (MX_64, MX_106, MX_28, MX_28, MX_28)
DRIVES = Drives(MOTORS)

STEP = 0.01
"""A trial is computed every so many seconds; between, it is interpolated."""
START, PLACES = 1.2, (0.3, -0.4, -1.1)
"""rad of the shoulder: where objects are picked up, and where they belong, the lightest first."""
DOWN, UP, REST = -0.5, 0.25, -0.1
"""rad of the elbow at the table and where it carries, and of the wrist's flexion."""
TURNED, LEVELLED = 0.5, 0.8
"""rad by which a wrist that moves turns an object, and how much of the elbow's way its flexion makes up for."""
OPEN, WIDTH, SQUEEZE = 0.9, 0.45, 0.05
"""rad of the hand: open, closed around an object, and by how much further it is told to close."""
BORNE = 0.02
"""rad by which the elbow has to lift an object until the table bears nothing of it: 7 mm."""
TURNING = 0.6
"""rad/s, the mean speed of the shoulder."""
SPREAD = 0.03
"""Standard deviation (rad) of where a way ends."""


class Move(NamedTuple):
    """A joint's way to `goal` (rad): from when on, and how long it takes (s)."""

    joint: int
    begins: float
    lasts: float
    goal: float


@dataclass(frozen=True)
class Trial:
    """What happens in a trial, `STEP` apart: shape (times, joints) each, but for what is `held` (kg).

    `goals` are what servos are told; `positions` where joints are, `velocities` (rad/s), `duties` (parts of
    the voltage) and `temperatures` (°C).
    """

    goals: FloatArray
    positions: FloatArray
    velocities: FloatArray
    duties: FloatArray
    temperatures: FloatArray
    held: FloatArray

    @property
    def lasts(self) -> float:
        """How long it takes (s)."""
        return (len(self.goals) - 1) * STEP


def trial(place: float, weight: float, before: FloatArray, rng: Generator, *, wrist: bool = False) -> Trial:
    """Return a trial that carries `weight` (kg) to a `place` (rad); the servos' temperatures were those `before`.

    With `wrist` the wrist moves too.
    """
    moves = list(_moves(place, rng))
    moves += _of_the_wrist(moves) if wrist else ()
    ends = max(move.begins + move.lasts for move in moves) + rng.uniform(0.3, 0.5)
    times = np.linspace(0.0, STEP * ceil(ends / STEP), ceil(ends / STEP) + 1)
    goals = _goals(moves, times)
    gripped = goals[:, HAND] < WIDTH
    held = np.where(gripped, weight * np.clip((goals[:, ELBOW] - DOWN) / BORNE, 0.0, 1.0), 0.0)
    return _gone_through(goals, gripped, held, before)


def _moves(place: float, rng: Generator) -> Iterator[Move]:
    """Yield the moves of a trial, each begun when those before it are over, but for the shoulder's."""
    there, carried = place + rng.normal(0.0, SPREAD), UP + rng.normal(0.0, SPREAD)
    turn = abs(there - START) / TURNING
    now = rng.uniform(0.4, 0.8)
    for joint, usual, goal in (
        (HAND, 1.0, WIDTH - SQUEEZE),
        (ELBOW, 1.5, carried),
        (ELBOW, 1.5, DOWN),
        (HAND, 0.8, OPEN),
        (ELBOW, 1.3, carried),
        (ELBOW, 1.4, DOWN),
    ):
        lasts = usual * rng.uniform(0.85, 1.15)
        yield Move(joint, now, lasts, goal)
        if goal == carried:
            turns = turn * rng.uniform(0.85, 1.15)
            yield Move(SHOULDER, now + 0.2, turns, there)
            there, lasts = START, max(lasts, turns + 0.2)
        now += lasts + rng.uniform(0.1, 0.4)


def _of_the_wrist(moves: Sequence[Move]) -> Iterator[Move]:
    """Yield what the wrist does while the elbow moves: up, down at the place, up, down at the start."""
    elbow = [move for move in moves if move.joint == ELBOW]
    for move, turned in zip(elbow, (0.0, TURNED, 0.0, 0.0), strict=True):
        yield move._replace(joint=FLEXION, goal=REST + LEVELLED * (DOWN - move.goal))
        yield move._replace(joint=ROTATION, goal=turned)


def _goals(moves: Sequence[Move], times: FloatArray) -> FloatArray:
    """Return what the servos are told at these times (s), shape (times, joints)."""
    pose = [START, DOWN, 0.0, REST, OPEN]
    goals = np.tile(pose, (len(times), 1))
    for move in moves:
        part = np.clip((times - move.begins) / move.lasts, 0.0, 1.0)
        goals[:, move.joint] += (move.goal - pose[move.joint]) * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        pose[move.joint] = move.goal
    return goals


def _gone_through(goals: FloatArray, gripped: BoolArray, held: FloatArray, before: FloatArray) -> Trial:
    """Return what servos do that are told these goals: they lag, and sag, by what their duty takes."""
    ways = goals.copy()
    ways[gripped, HAND] = WIDTH
    velocity = np.gradient(ways, STEP, axis=0)
    outside = np.zeros_like(ways)
    outside[:, :HAND] = torques(ways, held, STEP)
    torque = DRIVES.torque(outside, velocity, np.gradient(velocity, STEP, axis=0))
    duties = DRIVES.duty(torque, velocity)
    duties[gripped, HAND] = STIFFNESS * (goals - ways)[gripped, HAND]
    torque[gripped, HAND] = DRIVES.torque_at_rest(duties)[gripped, HAND]
    positions = goals - duties / STIFFNESS
    velocities = np.gradient(positions, STEP, axis=0)
    temperatures = DRIVES.warmed(before, DRIVES.tends_to(torque), STEP)
    return Trial(goals, positions, velocities, duties, temperatures, held)
