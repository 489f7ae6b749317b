"""The driver's two fakes: an arm that is a function of time, and the driver itself on an emulated bus.

Both take the driver's settings, and obey its limits by its own code.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from inspect import signature
from math import isfinite
from pathlib import Path
from tempfile import gettempdir
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

from rtagent.device import LastResort
from rtagent.errors import DeviceError
from rtagent.experience import Command
from rtagent.specs import Value
from rtagent_drivers.dynamixel.calibration import read_calibration
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.emulated.robots import BODIES, WEIGHTLESS
from rtagent_drivers.dynamixel.emulated.robots import Joint as EmulatedJoint
from rtagent_drivers.dynamixel.orders import questions, reads_in_groups, state_span
from rtagent_drivers.dynamixel.settings import Axis, axes, device_spec
from rtagent_drivers.dynamixel.timing import transaction
from rtagent_drivers.dynamixel.worlds import ArmWorld
from rtagent_drivers.fake import FakeDevice, Sampling

BEYOND = 0.3
"""The joints' mechanical stops are so far (rad) beyond their soft limits."""

EMULATOR = "rtagent_drivers.dynamixel.emulated.pty"
LINGER = "2s"
"""So long the emulated bus outlives a process that died: long enough to be made safe from outside."""


class FakeArm(FakeDevice):
    """An arm in the process; as the driver, it brings commands within their range."""

    async def act(self, command: Command) -> Command:
        """Hand a command to the world; return what became of it."""
        return await super().act({name: self._within(name, value) for name, value in command.items()})

    def _within(self, name: str, value: Value) -> Value:
        spec = self.spec.actuators.get(name)
        if spec is None or not isinstance(value, int | float) or not isfinite(value):
            return value
        return spec.clip(value)


def in_process(**settings: Any) -> FakeArm:
    """Return an arm with the driver's settings that needs no wire, and works under the virtual clock."""
    given = _complete(settings)
    arm = _axes(given)
    spec = device_spec(arm, given.rate)
    world = ArmWorld(arm, spec, given.stop, _emulated(arm, given))
    return FakeArm(world, Sampling(given.rate, _age(arm, given)), given.fake.faults)


class EmulatedArm(Dynamixel):
    """The driver on an emulated bus, in a process of its own that begins with the first `open`.

    The bus goes on while the driver is closed, and ends with it, or 2 s after the death of this process.
    """

    def __init__(self, **settings: Any) -> None:
        link = Path(gettempdir()) / f"rtagent-{uuid4().hex}"
        super().__init__(**{**settings, "port": str(link)})
        given = _complete(settings)
        self._command = _command(given, link, _emulated(_axes(given), given))
        self._emulator: subprocess.Popen[str] | None = None

    async def open(self) -> None:
        """Connect to the emulated bus; the first time, begin it. Raises as the driver does."""
        if self._emulator is None:
            self._emulator = await asyncio.to_thread(_started, self._command)
            weakref.finalize(self, _end, self._emulator)
        await super().open()

    def last_resort(self) -> LastResort:
        """Return how to make it safe without this process; it is no hardware that would stay latched."""
        return replace(super().last_resort(), hardware="")

    def tell(self, **order: Any) -> None:
        """Give the emulated bus an order while it runs (see emulated/control.py)."""
        if self._emulator is None or self._emulator.stdin is None:
            raise DeviceError("the emulated bus does not run yet: open the arm first.")
        self._emulator.stdin.write(json.dumps(order) + "\n")
        self._emulator.stdin.flush()


def on_wire(**settings: Any) -> EmulatedArm:
    """Return the driver with these settings on an emulated bus, on a pseudo-terminal."""
    return EmulatedArm(**settings)


def _complete(settings: Mapping[str, Any]) -> SimpleNamespace:
    """Return the driver's settings with its own defaults; it refuses here what it would refuse with hardware."""
    Dynamixel(**settings)
    bound = signature(Dynamixel).bind(**settings)
    bound.apply_defaults()
    return SimpleNamespace(**bound.arguments)


def _axes(given: SimpleNamespace) -> Sequence[Axis]:
    placings = read_calibration(Path(given.calibration)) if given.calibration else {}
    return axes(given.joints, given.protocol, placings)


def _emulated(arm: Sequence[Axis], given: SimpleNamespace) -> list[EmulatedJoint]:
    """Return the servos of an arm, with the bodies of the Bento Arm's joints where they bear their names."""
    return [_emulated_joint(axis, given) for axis in arm]


def _emulated_joint(axis: Axis, given: SimpleNamespace) -> EmulatedJoint:
    low, high = sorted((axis.angle(axis.low), axis.angle(axis.high)))
    body = replace(BODIES.get(axis.name, WEIGHTLESS), low=low - BEYOND, high=high + BEYOND)
    start = axis.joint.start if axis.joint.start is not None else min(max(0.0, axis.low), axis.high)
    position = axis.angle(given.fake.positions.get(axis.name, start))
    return EmulatedJoint(axis.name, axis.joint.id, axis.model.name, body, position, given.baud)


def _age(arm: Sequence[Axis], given: SimpleNamespace) -> int:
    """Return how old (ns) a sample is when it arrives: half a round of reading."""
    together = [state_span(axis.model, axis.joint.id) for axis in arm if reads_in_groups(axis.model)]
    singly = [state_span(axis.model, axis.joint.id) for axis in arm if not reads_in_groups(axis.model)]
    asked = questions(codec(given.protocol), together, singly)
    return sum(transaction(len(each.data), each.lengths, given.baud, 0) for each in asked) // 2


def _command(given: SimpleNamespace, link: Path, joints: Sequence[EmulatedJoint]) -> list[str]:
    servos = json.dumps([_as_json(joint) for joint in joints])
    timing = "true" if given.fake.timing else "false"
    command = [sys.executable, "-m", EMULATOR, "arm", "--link", str(link), "--protocol", str(given.protocol)]
    command += ["--joints", servos, "--timing", timing, "--linger", LINGER]
    return command + [each for fault in given.fake.wire for each in ("--fault", fault)]


def _as_json(joint: EmulatedJoint) -> dict[str, Any]:
    """Return a joint as JSON can hold it: with units, and without what is infinite."""
    body = {name: value for name, value in asdict(joint.body).items() if isfinite(value)}
    what = {"name": joint.name, "id": joint.id, "model": joint.model, "body": body}
    return {**what, "start": f"{joint.start!r}rad", "baud": f"{joint.baud}baud"}


def _started(command: Sequence[str]) -> subprocess.Popen[str]:
    """Return the emulator's process once its link is there; raise `DeviceError` with what it says where it ends."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(  # noqa: S603  # our own module, with our own Python
        command,
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,  # Ctrl-C is not for it
    )
    assert process.stdout is not None, "it was asked for"
    if not process.stdout.readline():
        _, said = process.communicate()
        raise DeviceError(f"the emulated bus did not begin: {said.strip()}")
    return process


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    process.communicate()
