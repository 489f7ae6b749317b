"""What a joint may be told, and what it may not come to: no I/O, so that driver and fake share it."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import Spec
from rtagent.units import ms, second
from rtagent_drivers.dynamixel.settings import Axis

LONGEST_STEP = 100 * ms
"""A command changes by no more than in this time, however long ago the last one was."""

OVERRUN = 0.15
"""So far (rad) a joint may be beyond a soft limit before that is a fault: servos overshoot a little."""

LOAD_MARGIN, LOAD_PATIENCE = 0.05, 500 * ms
"""Load is above its limit when it is so by this much, for so long: every start of a motion takes a moment of it."""

MEASURED = ("_told", "_told_at", "_was_inside", "_heavy_since")
"""What is saved."""


class Reading(NamedTuple):
    """What a joint measures: rad, rad/s, fraction of the full load, °C, V."""

    position: float
    velocity: float
    load: float
    temperature: float
    voltage: float


class JointLimits:
    """The limits of one joint: what it is told is brought within them, what it measures is held against them."""

    def __init__(self, axis: Axis, command: Spec) -> None:
        self._axis, self._spec = axis, command
        self._fastest_change = _fastest_change(axis)
        self.reset()

    def reset(self) -> None:
        """Begin anew from rest, as after it was made safe."""
        self._told, self._told_at = 0.0, -LONGEST_STEP
        self._was_inside, self._heavy_since = False, -1

    def save(self) -> Saved:
        """Return what was told, and what was measured lately."""
        return save_fields(self, MEASURED)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_fields(self, MEASURED, saved)

    def limit(self, value: float, now: int, reading: Reading | None) -> float:
        """Return the command nearest to `value` that is within limits, and remember it as given at `now` (ns)."""
        value = self._spec.clip(value)
        if self._axis.joint.mode == "position":
            return value
        if reading is not None and self._is_outward(value, reading.position):
            value = 0.0
        change = self._fastest_change * min(now - self._told_at, LONGEST_STEP) / second
        self._told = min(max(value, self._told - change), self._told + change)
        self._told_at = now
        return self._told

    def violated(self, reading: Reading, now: int, on: bool) -> str | None:
        """Say in a sentence which limit a reading at `now` (ns) is beyond, or return None.

        A joint that is not `on`, its torque off, may be anywhere: somebody may be moving it.
        """
        axis, joint = self._axis, self._axis.joint
        if reading.temperature > joint.max_temperature:
            return (
                f"{axis.name} is at {reading.temperature:.0f} °C, above its {joint.max_temperature:.0f} °C: "
                "let it cool down, and see what loads it."
            )
        if not on:
            self._was_inside, self._heavy_since = False, -1
            return None
        beyond = max(axis.low - reading.position, reading.position - axis.high)
        self._was_inside = self._was_inside or beyond <= 0.0
        if beyond > OVERRUN and self._was_inside:
            return (
                f"{axis.name} is at {reading.position:.3g} rad, beyond its limits {axis.low:.3g} to "
                f"{axis.high:.3g}: move it back by hand, and see what drove it there."
            )
        return self._overloaded(reading.load, now)

    def _overloaded(self, load: float, now: int) -> str | None:
        if abs(load) <= self._axis.joint.max_load + LOAD_MARGIN:
            self._heavy_since = -1
            return None
        self._heavy_since = now if self._heavy_since < 0 else self._heavy_since
        if now - self._heavy_since < LOAD_PATIENCE:
            return None
        return f"{self._axis.name} bears {abs(load):.0%} of its full load, more than max_load: see what blocks it."

    def _is_outward(self, value: float, position: float) -> bool:
        low, high = self._axis.low, self._axis.high
        return (value > 0.0 and position >= high) or (value < 0.0 and position <= low)


def _fastest_change(axis: Axis) -> float:
    """Return how fast a command may change, in its unit a second."""
    if axis.joint.mode == "torque":
        return second / axis.joint.torque_rise if axis.joint.torque_rise else inf
    return axis.joint.max_acceleration or inf
