"""The driver's two fakes: an arm that is a function of time, and the driver itself on an emulated bus.

Both take the driver's settings, and obey its limits by its own code.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from inspect import signature
from math import isfinite
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rtagent.device import LastResort
from rtagent_drivers.dynamixel.calibration import read_calibration
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.driver import Dynamixel
from rtagent_drivers.dynamixel.emulated.robots import BODIES, WEIGHTLESS
from rtagent_drivers.dynamixel.emulated.robots import Joint as EmulatedJoint
from rtagent_drivers.dynamixel.orders import questions, reads_in_groups, state_span
from rtagent_drivers.dynamixel.settings import Axis, axes, device_spec
from rtagent_drivers.dynamixel.timing import transaction
from rtagent_drivers.dynamixel.worlds import ArmWorld
from rtagent_drivers.emulation.starting import Emulation
from rtagent_drivers.fake import LimitedFake, Sampling

BEYOND = 0.3
"""The joints' mechanical stops are so far (rad) beyond their soft limits."""

EMULATOR = "rtagent_drivers.dynamixel.emulated.pty"


def in_process(**settings: Any) -> LimitedFake:
    """Return an arm with the driver's settings that needs no wire, and works under the virtual clock."""
    given = _complete(settings)
    arm = _axes(given)
    spec = device_spec(arm, given.rate)
    world = ArmWorld(arm, spec, given.stop, _emulated(arm, given))
    return LimitedFake(world, Sampling(given.rate, _age(arm, given)), given.fake.faults)


class EmulatedArm(Dynamixel):
    """The driver on an emulated bus, in a process of its own that begins with the first `open`.

    The bus goes on while the driver is closed, and ends with it, or 2 s after the death of this process.
    """

    def __init__(self, **settings: Any) -> None:
        given = _complete(settings)
        self.emulation = Emulation(EMULATOR, _arguments(given, _emulated(_axes(given), given)))
        super().__init__(**{**settings, "port": str(self.emulation.link)})

    async def open(self) -> None:
        """Connect to the emulated bus; the first time, begin it. Raises as the driver does."""
        await self.emulation.begin()
        await super().open()

    def last_resort(self) -> LastResort:
        """Return how to make it safe without this process; it is no hardware that would stay latched."""
        return replace(super().last_resort(), hardware="")


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


def _arguments(given: SimpleNamespace, joints: Sequence[EmulatedJoint]) -> list[str]:
    servos = json.dumps([_as_json(joint) for joint in joints])
    timing = "true" if given.fake.timing else "false"
    told = ["arm", "--protocol", str(given.protocol), "--joints", servos, "--timing", timing]
    return told + [each for fault in given.fake.wire for each in ("--fault", fault)]


def _as_json(joint: EmulatedJoint) -> dict[str, Any]:
    """Return a joint as JSON can hold it: with units, and without what is infinite."""
    body = {name: value for name, value in asdict(joint.body).items() if isfinite(value)}
    what = {"name": joint.name, "id": joint.id, "model": joint.model, "body": body}
    return {**what, "start": f"{joint.start!r}rad", "baud": f"{joint.baud}baud"}
