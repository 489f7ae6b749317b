"""The arm as point masses on a chain of axes: what torques a motion takes (Newton and Euler).

Upright stands the axis of the shoulder; the elbow is on it, and raises the forearm; the wrist turns about the
forearm, and raises the hand. Angles are 0 where the forearm is level and the hand in line with it. Servos have
the masses that the e-Manual states; lengths are those of a man of 1.75 m (Winter 2009, Biomechanics and Motor
Control of Human Movement, table 4.1), for whom the Bento Arm was made; of printed parts we assume 100 g in the
forearm and 60 g in the gripper. Bodies are points, with the inertia of the motors beside them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rtagent.experience import FloatArray
from rtagent_drivers.sorting.servos import MX_28

GRAVITY = np.array([0.0, 0.0, -9.81])
UPRIGHT = np.array([0.0, 0.0, 1.0])
FOREARM, GRIP = 0.146 * 1.75, 0.506 * 0.108 * 1.75
"""m: from the elbow to the axis of wrist flexion, and from there to what is held (the middle of a hand)."""


@dataclass(frozen=True)
class Mass:
    """A point mass (kg) on the forearm, behind the wrist's rotation, or on the hand; m along it and sideways."""

    mass: float
    part: str
    along: float
    sideways: float = 0.0


MASSES = (
    Mass(0.100, "forearm", 0.5 * FOREARM),  # printed parts
    Mass(MX_28.mass, "forearm", 0.6 * FOREARM),  # the servo of wrist rotation
    Mass(MX_28.mass, "wrist", FOREARM - 0.02, 0.01),  # that of wrist flexion, beside the axis
    Mass(MX_28.mass, "hand", 0.03, 0.015),  # that of the gripper
    Mass(0.060, "hand", 0.07),  # the gripper's chopsticks
)
HELD = Mass(0.0, "hand", GRIP)


class Frames(NamedTuple):
    """Directions, shape (times, 3): along, beside and above the forearm, behind the wrist, and of the hand."""

    along: FloatArray
    beside: FloatArray
    turned: FloatArray
    hand: FloatArray


def frames(angles: FloatArray) -> Frames:
    """Return the directions of the parts at these angles, shape (times, 4 or more): shoulder, elbow, wrist."""
    shoulder, elbow, rotation, flexion = (angles[:, joint, None] for joint in range(4))
    ahead = np.concatenate((np.cos(shoulder), np.sin(shoulder), np.zeros_like(shoulder)), axis=1)
    beside = np.concatenate((-np.sin(shoulder), np.cos(shoulder), np.zeros_like(shoulder)), axis=1)
    along = np.cos(elbow) * ahead + np.sin(elbow) * UPRIGHT
    above = np.cos(elbow) * UPRIGHT - np.sin(elbow) * ahead
    turned = np.cos(rotation) * beside + np.sin(rotation) * above
    raised = np.cos(rotation) * above - np.sin(rotation) * beside
    return Frames(along, beside, turned, np.cos(flexion) * along + np.sin(flexion) * raised)


def place(mass: Mass, at: Frames) -> FloatArray:
    """Return where a mass is (m from the elbow), shape (times, 3)."""
    if mass.part == "forearm":
        found: FloatArray = mass.along * at.along + mass.sideways * at.beside
    elif mass.part == "wrist":
        found = mass.along * at.along + mass.sideways * at.turned
    else:
        found = FOREARM * at.along + mass.along * at.hand + mass.sideways * at.turned
    return found


def torques(angles: FloatArray, held: FloatArray, step: float) -> FloatArray:
    """Return the torques (Nm) about shoulder, elbow, wrist rotation and flexion, shape (times, 4).

    `angles`, shape (times, 4 or more), are `step` (s) apart; `held`, shape (times,), is the mass (kg) in the hand.
    """
    at = frames(angles)
    wrist = FOREARM * at.along
    found = np.zeros((len(angles), 4))
    for mass in (*MASSES, HELD):
        where = place(mass, at)
        amount = held if mass is HELD else np.full(len(angles), mass.mass)
        force = amount[:, None] * (_second_derivative(where, step) - GRAVITY)
        turning = np.cross(where, force)
        found[:, 0] += turning[:, 2]
        found[:, 1] -= _along(turning, at.beside)
        if mass.part != "forearm":
            found[:, 2] += _along(turning, at.along)
        if mass.part == "hand":
            found[:, 3] -= _along(np.cross(where - wrist, force), at.turned)
    return found


def _along(vectors: FloatArray, directions: FloatArray) -> FloatArray:
    products: FloatArray = np.einsum("ij,ij->i", vectors, directions)
    return products


def _second_derivative(values: FloatArray, step: float) -> FloatArray:
    """Return the second derivative in time by central differences; 0 at the ends, where the arm rests."""
    found = np.zeros_like(values)
    found[1:-1] = (values[2:] - 2.0 * values[1:-1] + values[:-2]) / step**2
    return found
