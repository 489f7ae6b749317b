"""One joint's servo: its readings as the joint's, the joint's commands as its orders. No I/O."""

from __future__ import annotations

from math import copysign
from typing import NamedTuple

from rtagent.errors import SpecError
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import Spec, Value
from rtagent.units import ms, second
from rtagent_drivers.dynamixel.layout import Layout
from rtagent_drivers.dynamixel.limits import JointLimits, Reading
from rtagent_drivers.dynamixel.orders import (
    STATE,
    Order,
    pushing,
    speed_register,
    state_span,
    stay,
    towards,
    turning,
)
from rtagent_drivers.dynamixel.settings import Axis
from rtagent_drivers.dynamixel.values import to_si, unpack

AHEAD = 50 * ms
"""So far ahead a motion is extrapolated, at most."""

KNOWN = ("read_at", "silent_since", "error", "on")
"""What is saved as it is."""


class Told(NamedTuple):
    """An order, and what it means for the joint (in its actuator's unit)."""

    order: Order
    value: float


class Servo:
    """A servo as a joint, with what is known of it: its newest reading, and whether its torque is on."""

    def __init__(self, axis: Axis, command: Spec) -> None:
        self.axis, self.id, self.model = axis, axis.joint.id, axis.model
        self.limits = JointLimits(axis, command)
        self.span = state_span(self.model, self.id)
        self._command = command
        self._layout = Layout([self.model.registers[name] for name in STATE])
        name = axis.name
        self.sensors = tuple(
            f"{name}_{each}" for each in ("position", "velocity", "load", "temperature", "voltage")
        )
        self.fresh = f"{name}_fresh"
        self.forget()

    def forget(self) -> None:
        """Forget what was known, as when the line was lost."""
        self.reading: Reading | None = None
        self.read_at = 0
        self.silent_since: int | None = None
        self.error = 0
        self.on = False
        self._rests: Order | None = None
        self.limits.reset()

    def save(self) -> Saved:
        """Return what is known of it."""
        reading = None if self.reading is None else list(self.reading)
        rests = None if self._rests is None else [self._rests.address, list(self._rests.data)]
        return {"reading": reading, "limits": self.limits.save(), "rests": rests} | save_fields(self, KNOWN)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        reading, rests = saved["reading"], saved["rests"]
        self.reading = None if reading is None else Reading(*reading)
        self._rests = None if rests is None else Order(rests[0], bytes(rests[1]))
        self.limits.restore(saved["limits"])
        restore_fields(self, KNOWN, saved)

    def hear(self, data: bytes, now: int) -> Reading:
        """Take what the servo measured, at `now` (ns), in joint coordinates."""
        angle, velocity, load, voltage, temperature = self._layout.values(data)
        direction = self.axis.direction
        self.reading = Reading(
            self.axis.position(angle),
            direction * velocity,
            min(max(direction * load, -1.0), 1.0),
            temperature,
            voltage,
        )
        self.read_at, self.silent_since = now, None
        return self.reading

    def miss(self, now: int) -> None:
        """Note that it did not answer, at `now` (ns)."""
        if self.silent_since is None:
            self.silent_since = now

    def told(self, value: Value, now: int) -> Told:
        """Return the order for a command, after limits; raise `SpecError` for what is no number."""
        if isinstance(value, bool) or not isinstance(value, int | float) or value != value:  # NaN
            raise SpecError(f"{self.axis.actuator} was told {value!r}: it takes {self._command}.")
        limited = self.limits.limit(float(value), now, self.reading)
        order, sent = self._order(limited, now)
        return Told(order, self._command.clip(sent))

    def stay(self, now: int) -> Order:
        """Return the order to stay where the joint is `now`."""
        self._rests = None
        return stay(self.model, self.axis.joint.mode, self.axis.angle(self._position(now)))

    def go(self, position: float, speed: float) -> Order:
        """Return the order to go to a position, in modes position and velocity."""
        self._rests = None
        return towards(self.model, self.axis.angle(position), speed)

    def _position(self, now: int) -> float:
        """Return where the joint is by now, going on as it did when it was read."""
        assert self.reading is not None, "a servo is told nothing before it was read"
        return self.reading.position + self.reading.velocity * min(now - self.read_at, AHEAD) / second

    def _order(self, value: float, now: int) -> tuple[Order, float]:
        axis, mode, direction = self.axis, self.axis.joint.mode, self.axis.direction
        if mode == "position":
            order = self.go(value, axis.max_velocity)
            return order, self._meaning(order, "goal_position")
        if mode == "velocity":
            return self._velocity(value, now)
        if mode == "torque":
            order = pushing(self.model, direction * value)
            return order, direction * self._count(order, "goal_torque")
        order = turning(self.model, direction * value)
        return order, direction * self._count(order, "goal_velocity")

    def _velocity(self, value: float, now: int) -> tuple[Order, float]:
        """Go to a soft limit at a speed. What is slower than one count is a stop: 0 would be full speed.

        A stop that is told again aims at the same place: from readings of a joint that still moves, each would be
        at another, and it would never come to rest.
        """
        register = self.model.registers[speed_register(self.model)]
        if abs(value) < register.scale / 2:
            self._rests = self._rests or self.stay(now)
            return self._rests, 0.0
        order = self.go(self.axis.high if value > 0 else self.axis.low, abs(value))
        return order, copysign(self._count(order, speed_register(self.model)), value)

    def _meaning(self, order: Order, name: str) -> float:
        return self.axis.position(self._count(order, name))

    def _count(self, order: Order, name: str) -> float:
        register = self.model.registers[name]
        return to_si(register, unpack(register, order.data, register.address - order.address))
