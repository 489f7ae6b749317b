"""An arm of Dynamixel servos as a function of time: emulated servos under the driver's own orders and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy.random import Generator

from rtagent.errors import LimitError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved, restore_parts, save_parts
from rtagent.specs import DeviceSpec, Value
from rtagent.units import second
from rtagent_drivers.dynamixel.emulated.robots import Joint as EmulatedJoint
from rtagent_drivers.dynamixel.emulated.servo import Servo as EmulatedServo
from rtagent_drivers.dynamixel.emulated.supply import Supply
from rtagent_drivers.dynamixel.faults import is_grave, sentences
from rtagent_drivers.dynamixel.limits import Reading
from rtagent_drivers.dynamixel.opening import volatile
from rtagent_drivers.dynamixel.orders import HOLD_SPEED, Order, switch
from rtagent_drivers.dynamixel.safe_state import safe_order
from rtagent_drivers.dynamixel.servo import Servo, Told
from rtagent_drivers.dynamixel.settings import Axis, Stop

SETTLING = second // 2
"""An arm that goes home is released so long (ns) after it should be there."""


class ArmWorld:
    """An arm with these axes; `joints` are their servos as they are emulated, in the same order."""

    def __init__(self, axes: Sequence[Axis], spec: DeviceSpec, stop: Stop, joints: Sequence[EmulatedJoint]) -> None:
        self.spec = spec
        self._axes, self._stop, self._emulated = axes, stop, joints
        self._joints: dict[str, _Joint] = {}
        self._release_at: int | None = None

    def begin(self, now: int, rng: Generator) -> None:
        """Put the joints that have a start pose there; the first time, all are made where they are to be, limp."""
        if not self._joints:
            self._make(now)
            return
        self._release_at = None
        for joint in self._joints.values():
            joint.begin(now)

    def values(self, time: int) -> Values:
        """Return what the servos measure at `time` (ns); raise `LimitError` for what the driver would not bear."""
        self._pass(time)
        values: dict[str, Value] = {}
        for joint in self._joints.values():
            values.update(joint.values(time))
        return values

    def command(self, now: int, command: Command) -> Command:
        """Send a command as the driver does; return what was sent, after limits."""
        self._release_at = None
        return {name: self._joints[name].act(now, value) for name, value in command.items()}

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: what calls for a reaction is not the arm's."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return None: an arm is sampled."""
        return None

    def make_safe(self, now: int) -> None:
        """Hold, release, or go home and then release."""
        self._pass(now)
        joints = self._joints.values()
        ways = [joint.go_home(now) for joint in joints] if self._stop == "home" else []
        if any(ways):
            self._release_at = now + max(ways) + SETTLING
        else:
            self._make_safe(now)

    def save(self) -> Saved:
        """Return the joints, and when they are to be released."""
        return {"joints": save_parts(self._joints), "release_at": self._release_at}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        restore_parts(self._joints, saved["joints"])
        self._release_at = saved["release_at"]

    def _pass(self, time: int) -> None:
        """Let happen what was to come until `time`."""
        if self._release_at is not None and self._release_at <= time:
            at, self._release_at = self._release_at, None
            self._make_safe(at)

    def _make_safe(self, now: int) -> None:
        stop: Stop = "hold" if self._stop == "hold" else "release"
        for joint in self._joints.values():
            joint.make_safe(now, stop)

    def _make(self, now: int) -> None:
        supply = Supply()
        for axis, emulated in zip(self._axes, self._emulated, strict=True):
            servo = EmulatedServo(emulated, now, supply.voltage, lambda *_: None)
            supply.feed(servo)
            self._joints[axis.actuator] = _Joint(Servo(axis, self.spec.actuators[axis.actuator]), servo)


class _Joint:
    """A joint as the driver knows it, and the servo that takes its orders."""

    def __init__(self, driven: Servo, servo: EmulatedServo) -> None:
        self._driven, self._servo = driven, servo
        kept = driven.model.modes[driven.axis.joint.mode]
        for name, count in [*kept.items(), *volatile(driven)]:
            servo.memory[name] = count

    def save(self) -> Saved:
        """Return both sides of it."""
        return {"driven": self._driven.save(), "servo": self._servo.save()}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self._driven.restore(saved["driven"])
        self._servo.restore(saved["servo"])

    def begin(self, now: int) -> None:
        start = self._driven.axis.joint.start
        if start is not None:
            self._servo.place(now, self._driven.axis.angle(start))
            self._measure(now)
            self._switch_on(now)
            self._order(now, self._driven.go(start, HOLD_SPEED))

    def values(self, time: int) -> Mapping[str, Value]:
        reading, driven = self._measure(time), self._driven
        said = driven.limits.violated(reading, time, driven.on) or self._complaint()
        if said:
            raise LimitError(said)
        return {**dict(zip(driven.sensors, reading, strict=True)), driven.fresh: True}

    def act(self, now: int, value: Value) -> float:
        if self._driven.reading is None:
            self._measure(now)
        told: Told = self._driven.told(value, now)
        self._switch_on(now)
        self._order(now, told.order)
        return told.value

    def make_safe(self, now: int, stop: Stop) -> None:
        if self._driven.reading is not None:
            self._measure(now)
        self._order(now, safe_order(self._driven, stop, now))
        self._driven.on = self._driven.on and stop == "hold" and self._driven.axis.joint.mode != "torque"
        self._driven.limits.reset()

    def go_home(self, now: int) -> int:
        """Go to the start pose, and return how long (ns) that takes: 0 where there is none, or torque is off."""
        start = self._driven.axis.joint.start
        if start is None or not self._driven.on:
            return 0
        self._order(now, self._driven.go(start, HOLD_SPEED))
        return round(abs(self._measure(now).position - start) / HOLD_SPEED * second)

    def _measure(self, time: int) -> Reading:
        self._servo.advance(time)
        span = self._driven.span
        data = self._servo.read(time, span.address, span.length)
        assert data is not None, "the driver reads what its model has"
        return self._driven.hear(data, time)

    def _complaint(self) -> str | None:
        """Return what is wrong with the servo, in the driver's words."""
        model, memory = self._driven.model, self._servo.memory
        error, hardware = self._servo.error(), memory.get("hardware_error")
        if not is_grave(model.protocol, error, hardware):
            return None
        said = sentences(model.protocol, error, hardware)
        return " ".join(f"{self._driven.axis.name} (id {self._driven.id}) {each}" for each in said)

    def _switch_on(self, now: int) -> None:
        if not self._driven.on:
            self._order(now, self._driven.stay(now))
            self._order(now, switch(self._driven.model, on=True))
            self._driven.on = True

    def _order(self, now: int, order: Order) -> None:
        self._servo.write(now, order.address, order.data)
