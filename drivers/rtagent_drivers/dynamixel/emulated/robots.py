"""The arms that can be emulated, as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from rtagent.errors import SpecError
from rtagent.units import Angle, Baud, Duration
from rtagent_drivers.dynamixel.emulated.faults import CLOSED_SETTINGS
from rtagent_drivers.dynamixel.steps import Body

WEIGHTLESS = Body()


@dataclass(frozen=True)
class Joint:
    """A servo on the bus and what it moves; it begins, limp, at `start` (rad).

    `baud` is at what it listens, `return_delay` how long it waits before it answers (from the factory 500 µs).
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    name: str
    id: int
    model: str
    body: Body = WEIGHTLESS
    start: Angle = 0.0
    baud: Baud = 1_000_000
    return_delay: Duration = 0

    def __post_init__(self) -> None:
        if not self.body.low <= self.start <= self.body.high:
            low, high = self.body.low, self.body.high
            raise SpecError(f"{self.name} cannot be at {self.start:g} rad: its stops are at {low:g} and {high:g}.")


STOP = 2.6
"""Where the joints meet their mechanical stops (rad)."""

SHOULDER = Body(inertia=0.05, gravity=0.0, friction=0.06, low=-STOP, high=STOP)  # turns about the vertical
ELBOW = Body(inertia=0.04, gravity=0.35, friction=0.05, low=-STOP, high=STOP)
WRIST_ROTATION = Body(inertia=0.01, gravity=0.0, friction=0.04, low=-STOP, high=STOP)
WRIST_FLEXION = Body(inertia=0.02, gravity=0.12, friction=0.04, low=-STOP, high=STOP)
HAND = Body(inertia=0.005, gravity=0.0, friction=0.05, low=-STOP, high=STOP)

BODIES = {
    "shoulder": SHOULDER,
    "elbow": ELBOW,
    "wrist_rotation": WRIST_ROTATION,
    "wrist_flexion": WRIST_FLEXION,
    "hand": HAND,
}


def arm(models: Sequence[str]) -> tuple[Joint, ...]:
    """Return an arm of five joints, with the ids 1 to 5, from the shoulder on."""
    named = zip(BODIES.items(), models, strict=True)
    return tuple(Joint(name, number, model, body) for number, ((name, body), model) in enumerate(named, start=1))


BENTO = arm(("MX-64", "MX-106", "MX-28", "MX-28", "MX-28"))
MINI_BENTO = arm(("XL330-M288",) * 5)


def with_new_firmware(joints: Sequence[Joint]) -> tuple[Joint, ...]:
    """Return the same arm, its MX servos with the firmware for protocol 2.0."""
    return tuple(replace(joint, model=f"{joint.model}-2.0") for joint in joints)


ROBOTS: Mapping[str, Mapping[int, tuple[Joint, ...]]] = {
    "bento": {1: BENTO, 2: with_new_firmware(BENTO)},
    "mini_bento": {2: MINI_BENTO},
}
"""By name and protocol; the first protocol is the usual one."""
