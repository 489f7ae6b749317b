"""The settings of Dynamixel joints, and what follows from them: axes with their limits, and the device's spec."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, isfinite, tau
from typing import ClassVar, Literal

from rtagent.errors import SpecError, did_you_mean
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Angle, AngularAcceleration, AngularVelocity, Duration
from rtagent_drivers.dynamixel.models import MODELS, Mode, Model
from rtagent_drivers.dynamixel.values import bounds, to_si
from rtagent_drivers.fake import CLOSED_SETTINGS, Faults

Stop = Literal["hold", "release", "home"]
"""What making safe means: stay there with torque on, go limp, or go to the start pose and then go limp."""

ACTUATOR: Mapping[Mode, str] = {
    "position": "position",
    "velocity": "velocity",
    "wheel": "velocity",
    "torque": "torque",
}
QUANTITIES = ("position", "velocity", "load", "temperature", "voltage")
HOTTEST, HIGHEST_VOLTAGE, SPEED_MARGIN = 150.0, 30.0, 3.0


@dataclass(frozen=True)
class Joint:
    """A servo as a joint: its id and model, how it is commanded, where its zero is, and its limits.

    A joint's angle is `direction` × (the servo's angle, from the middle of its range, − `zero`). Commands are
    limited to `low` … `high` (rad), `max_velocity` (rad/s; 0: the servo's top speed), `max_acceleration` (rad/s²;
    velocity commands change no faster; 0: at once) and `torque_rise` (how long a torque command takes from 0 to
    all, at least). A `max_load` (fraction of the full one) bounds what the servo may exert; a joint hotter than
    `max_temperature` (°C) ends the run. `start` is where an episode begins.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    id: int
    model: str
    mode: Mode = "position"
    zero: Angle | None = None
    direction: Literal[1, -1] | None = None
    low: Angle | None = None
    high: Angle | None = None
    max_velocity: AngularVelocity = 0.0
    max_acceleration: AngularAcceleration = 0.0
    torque_rise: Duration = 0
    max_load: float = 1.0
    max_temperature: float = 70.0
    start: Angle | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.id <= 252:
            raise SpecError(f"the id of a joint is {self.id}: give 0 to 252.")
        if not 0.0 < self.max_load <= 1.0:
            raise SpecError(f"max_load is {self.max_load}: give a fraction of the full load, above 0 and up to 1.")
        if self.max_velocity < 0.0 or self.max_acceleration < 0.0 or self.torque_rise < 0:
            raise SpecError("max_velocity, max_acceleration or torque_rise is negative: give 0 or more.")
        if not isfinite(self.max_temperature):
            raise SpecError(f"max_temperature is {self.max_temperature}: give degrees Celsius, such as 70.")


@dataclass(frozen=True)
class FakeSettings:
    """How the driver's fakes behave: where joints are at first (rad), and what goes wrong.

    `timing`: the emulated bus takes as long as a true one. `faults` are those of a fake in the process, `wire`
    those of an emulated bus (see `rtagent emulate`), each as JSON.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    positions: Mapping[str, Angle] = field(default_factory=dict)
    timing: bool = False
    faults: Faults = field(default_factory=Faults)
    wire: tuple[str, ...] = ()


@dataclass(frozen=True)
class Placing:
    """Where a joint's zero is, which way it turns, and how far: what a calibration finds out (rad)."""

    zero: float = 0.0
    direction: int = 1
    low: float = -inf
    high: float = inf


@dataclass(frozen=True)
class Axis:
    """A joint with everything that follows from its model, its settings and its calibration (rad, rad/s)."""

    name: str
    joint: Joint
    model: Model
    zero: float
    direction: int
    low: float
    high: float
    max_velocity: float

    @property
    def actuator(self) -> str:
        """The name of what it is commanded by, such as shoulder_velocity."""
        return f"{self.name}_{ACTUATOR[self.joint.mode]}"

    @property
    def turns_on(self) -> bool:
        """Whether it may turn without end."""
        return self.joint.mode in ("wheel", "torque")

    def position(self, angle: float) -> float:
        """Return the joint's position at an angle of the servo; within a turn where the servo knows no more."""
        position = self.direction * (angle - self.zero)
        low, high = self.reach
        if low <= position <= high or high - low < 0.99 * tau:
            return position
        return (position - low) % tau + low

    def angle(self, position: float) -> float:
        """Return the servo's angle at a position of the joint."""
        return self.direction * position + self.zero

    @cached_property
    def reach(self) -> tuple[float, float]:
        """The positions that its servo can measure, in the joint's own angles."""
        if self.turns_on:
            return -tau / 2, tau / 2
        ends = sorted(self.direction * (angle - self.zero) for angle in servo_range(self.model))
        return ends[0], ends[1]


def servo_range(model: Model) -> tuple[float, float]:
    """Return the angles (rad) that a servo of this model can go to."""
    registers = model.registers
    least, most = registers["goal_position"], registers["goal_position"]
    if "max_position_limit" in registers:
        least, most = registers["min_position_limit"], registers["max_position_limit"]
    return to_si(least, bounds(least)[0]), to_si(most, bounds(most)[1])


def axes(joints: Mapping[str, Joint], protocol: int, calibration: Mapping[str, Placing]) -> tuple[Axis, ...]:
    """Return the axes of an arm; raise `SpecError` where its settings cannot be."""
    if not joints:
        raise SpecError("an arm has at least one joint: give joints.")
    ids = [joint.id for joint in joints.values()]
    twice = sorted({number for number in ids if ids.count(number) > 1})
    if twice:
        raise SpecError(f"several joints have the id {twice[0]}: each servo has an id of its own.")
    unknown = sorted(calibration.keys() - joints.keys())
    if unknown:
        raise SpecError(f"the calibration knows a joint {unknown[0]!r}{did_you_mean(unknown[0], list(joints))}")
    return tuple(
        _axis(name, joint, find_model(joint.model, protocol), calibration.get(name))
        for name, joint in joints.items()
    )


def find_model(name: str, protocol: int) -> Model:
    """Return the model of that name with the firmware of that protocol; raise `SpecError`."""
    for known in (name, f"{name}-{protocol}.0"):
        if known in MODELS and MODELS[known].protocol == protocol:
            return MODELS[known]
    there = sorted(each.name for each in MODELS.values() if each.protocol == protocol)
    raise SpecError(f"there is no model {name!r} with protocol {protocol}.0{did_you_mean(name, there)}")


def _axis(name: str, joint: Joint, model: Model, placing: Placing | None) -> Axis:
    if joint.mode not in model.modes:
        raise SpecError(f"{name}: {model.name} has no mode {joint.mode!r}: use one of {', '.join(model.modes)}.")
    placed = placing or Placing()
    if placing is not None and (joint.zero is not None or joint.direction is not None):
        raise SpecError(f"{name}: zero and direction are in the calibration: leave them out of the joint.")
    zero = placed.zero if joint.zero is None else joint.zero
    direction = placed.direction if joint.direction is None else joint.direction
    axis = Axis(name, joint, model, zero, direction, -inf, inf, joint.max_velocity or model.top_speed)
    low, high = _soft_limits(axis, placed)
    return Axis(name, joint, model, zero, direction, low, high, axis.max_velocity)


def _soft_limits(axis: Axis, placed: Placing) -> tuple[float, float]:
    """Return the joint's own limits within those of the calibration, within the reach of the servo."""
    joint, (least, most) = axis.joint, axis.reach
    if axis.turns_on:
        least, most = -inf, inf
    low = max(least, placed.low, -inf if joint.low is None else joint.low)
    high = min(most, placed.high, inf if joint.high is None else joint.high)
    if not low < high:
        raise SpecError(f"{axis.name}: nothing is left between low and high: it can go from {least:g} to {most:g}.")
    if joint.start is not None and not low <= joint.start <= high:
        raise SpecError(f"{axis.name}: start is {joint.start:g} rad, outside its limits {low:g} to {high:g}.")
    return low, high


def device_spec(arm: Sequence[Axis], rate: float) -> DeviceSpec:
    """Return what an arm senses and takes, `rate` (Hz) times a second."""
    sensors = {name: spec for axis in arm for name, spec in _sensors(axis)}
    return DeviceSpec(sensors, {axis.actuator: _command(axis) for axis in arm}, rate)


def _sensors(axis: Axis) -> Iterator[tuple[str, Spec]]:
    low, high = axis.reach
    fastest = SPEED_MARGIN * axis.model.top_speed
    yield f"{axis.name}_position", Spec(unit="rad", low=low, high=high)
    yield f"{axis.name}_velocity", Spec(unit="rad/s", low=-fastest, high=fastest)
    yield f"{axis.name}_load", Spec(low=-1.0, high=1.0)
    yield f"{axis.name}_temperature", Spec(unit="°C", low=0.0, high=HOTTEST)
    yield f"{axis.name}_voltage", Spec(unit="V", low=0.0, high=HIGHEST_VOLTAGE)
    yield f"{axis.name}_fresh", Spec.flag()


def _command(axis: Axis) -> Spec:
    if axis.joint.mode == "position":
        return Spec(unit="rad", low=axis.low, high=axis.high)
    if axis.joint.mode == "torque":
        return Spec(low=-axis.joint.max_load, high=axis.joint.max_load)
    return Spec(unit="rad/s", low=-axis.max_velocity, high=axis.max_velocity)
