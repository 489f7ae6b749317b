"""`rtagent calibrate` for an arm of Dynamixel servos: limp, in a person's hands."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rtagent.calibrating import Person
from rtagent.errors import SpecError
from rtagent.experience import Sample
from rtagent_drivers.dynamixel.calibration import check_folder, write_calibration
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.settings import Joint, Placing

LEAST_TURN = 0.1
"""A joint was turned if it was turned by so much (rad)."""

INSET = 0.02
"""The soft limits are so much (rad) within the ends that were shown."""


async def calibrate(person: Person, **settings: Any) -> str:
    """Lead a person through the calibration of an arm; write its file, and return a sentence on that.

    `settings` are the driver's. Raises `SpecError` where they name no file, and what the driver raises.
    """
    if not settings.get("calibration"):
        raise SpecError('the device names no file to keep it in: give it calibration = "arm.toml".')
    file, joints = Path(settings["calibration"]), settings["joints"]
    check_folder(file)
    async with _limp(person, joints, settings) as arm:
        hands = Hands(person, arm, list(joints))
        placings = await hands.lead()
    write_calibration(file, placings)
    return f"{file} has the zero, direction and limits of {', '.join(placings)}."


@contextlib.asynccontextmanager
async def _limp(
    person: Person, joints: Mapping[str, Joint], settings: Mapping[str, Any]
) -> AsyncIterator[Dynamixel]:
    """Give the arm without calibration, its torque off."""
    plain = {
        name: replace(joint, zero=None, direction=None, low=None, high=None, start=None)
        for name, joint in joints.items()
    }
    arm = Dynamixel(**{**settings, "joints": plain, "calibration": "", "stop": "release"})
    await arm.open()
    try:
        await person.does("Hold the arm: its torque goes off now.", dict)
        await arm.make_safe()
        yield arm
    finally:
        await arm.close()


class Hands:
    """A person's hands on the joints of an arm, and what the servos measure meanwhile."""

    def __init__(self, person: Person, arm: Dynamixel, joints: list[str]) -> None:
        self._person, self._arm, self._joints = person, arm, joints
        self._angles: dict[str, float] = {}
        self._least: dict[str, float] = {}
        self._most: dict[str, float] = {}

    async def lead(self) -> Mapping[str, Placing]:
        """Ask for the zero pose, each joint's positive direction, and its ends; return what was found out."""
        await self._look()
        watching = asyncio.ensure_future(self._watch())
        try:
            return await self._steps(watching)
        finally:
            watching.cancel()

    async def _steps(self, watching: asyncio.Future[None]) -> Mapping[str, Placing]:
        await self._step(watching, "Put every joint where its angle is to be 0.")
        zeros = dict(self._angles)
        placings = {}
        for joint in self._joints:
            direction = await self._direction(watching, joint, zeros[joint])
            placings[joint] = await self._ends(watching, joint, zeros[joint], direction)
        return placings

    async def _direction(self, watching: asyncio.Future[None], joint: str, zero: float) -> int:
        turned = 0.0
        while abs(turned) < LEAST_TURN:
            await self._step(watching, f"Turn {joint} in its positive direction, by 10 degrees at least.")
            turned = self._angles[joint] - zero
        return 1 if turned > 0 else -1

    async def _ends(self, watching: asyncio.Future[None], joint: str, zero: float, direction: int) -> Placing:
        low = high = 0.0
        while high - low < LEAST_TURN:
            self._least[joint] = self._most[joint] = self._angles[joint]
            await self._step(watching, f"Turn {joint} to both ends of its range.")
            ends = sorted(direction * (angle - zero) for angle in (self._least[joint], self._most[joint]))
            low, high = ends[0] + INSET, ends[1] - INSET
        return Placing(zero, direction, low, high)

    async def _step(self, watching: asyncio.Future[None], instruction: str) -> None:
        """Wait for the person; raise what the arm raises meanwhile."""
        doing = asyncio.ensure_future(self._person.does(instruction, self._shown))
        await asyncio.wait({doing, watching}, return_when=asyncio.FIRST_COMPLETED)
        if watching.done():
            doing.cancel()
            watching.result()
        await doing
        await self._look()

    async def _look(self) -> None:
        """Take where every joint is from now on: one that does not answer is waited for."""
        sequence, seen = (await self._arm.read(-1)).sequence, set[str]()
        while seen < set(self._joints):
            sample = await self._arm.read(sequence)
            sequence = sample.sequence
            seen |= self._take(sample)

    async def _watch(self) -> None:
        """Follow the joints, so that no end that they reach is missed."""
        sequence = -1
        while True:
            sample = await self._arm.read(sequence)
            sequence = sample.sequence
            self._take(sample)

    def _take(self, sample: Sample) -> set[str]:
        """Take the joints that answered, and return them."""
        fresh = {joint for joint in self._joints if sample.values[f"{joint}_fresh"]}
        for joint in fresh:
            angle = self._angles[joint] = float(sample.values[f"{joint}_position"])
            self._least[joint] = min(angle, self._least.get(joint, angle))
            self._most[joint] = max(angle, self._most.get(joint, angle))
        return fresh

    def _shown(self) -> Mapping[str, str]:
        return {
            joint: f"{angle:+.3f} rad   from {self._least[joint]:+.3f} to {self._most[joint]:+.3f}"
            for joint, angle in sorted(self._angles.items())
        }
