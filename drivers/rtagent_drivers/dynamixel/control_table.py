"""What a control table says, as data; the tables themselves are in `tables_*.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import pi
from typing import Literal

Encoding = Literal["unsigned", "signed", "sign_magnitude"]
Quantity = Literal[
    "none", "position", "velocity", "acceleration", "load", "current", "temperature", "voltage", "time"
]
Mode = Literal["position", "velocity", "wheel", "torque"]
"""How a joint is commanded: to an angle; at a speed towards a soft limit, where the servo ends by itself;
at a speed without end; or with a fraction of its full torque (or current)."""


@dataclass(frozen=True, slots=True)
class Register:
    """A stretch of the control table: `size` bytes at `address`, little-endian.

    One count is `scale` in SI units (rad, rad/s, rad/s², fraction of the full load, A, °C, V, s), and `zero` counts
    are 0. For `sign_magnitude` the highest of `bits` bits is the sign. `low` and `high` are the least and the
    greatest count that it takes, None where only its bytes limit it; `initial` is its count from the factory.
    """

    address: int
    size: int
    quantity: Quantity = "none"
    scale: float = 1.0
    zero: int = 0
    encoding: Encoding = "unsigned"
    bits: int = 0
    writable: bool = False
    eeprom: bool = False
    initial: int = 0
    low: int | None = None
    high: int | None = None


@dataclass(frozen=True, eq=False)  # there is one of each: it can be a key
class Model:
    """A kind of servo: its number (what it says of itself), protocol, registers by name, and modes.

    `source` is where the table was published. Registers that mean the same have the same name in every model:
    model_number, firmware_version, id, baud_rate, return_delay, status_return_level, torque_enable, led,
    goal_position, goal_velocity, goal_torque, moving_speed (1.0) or profile_velocity (2.0), torque_limit (1.0),
    present_position, present_velocity, present_load, present_voltage, present_temperature, moving, bus_watchdog,
    hardware_error, operating_mode, cw_angle_limit, ccw_angle_limit, and so on.
    Some are two views of one place: in 1.0 goal_velocity (signed, wheel mode) and moving_speed (joint mode).
    Where a servo measures its current, present_load and goal_torque are currents, as fractions of the greatest.
    """

    name: str
    number: int
    protocol: int
    source: str
    registers: Mapping[str, Register]
    modes: Mapping[Mode, Mapping[str, int]] = field(default_factory=dict)
    """What is written, with torque off, to bring it into each mode that it has."""
    stall_torque: float = 0.0
    """N·m at its nominal voltage."""
    top_speed: float = 0.0
    """rad/s without load at its nominal voltage."""
    nominal_voltage: float = 12.0
    """V."""

    @property
    def counts_per_turn(self) -> int:
        """How many counts of position a full turn would be."""
        return round(2 * pi / self.registers["present_position"].scale)
