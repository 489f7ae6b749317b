"""The supply of all servos on a bus: its voltage sags under their loads."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rtagent_drivers.dynamixel.emulated.servo import Servo

SAG = 0.08
"""Volts that it drops for each motor's full load."""


class Supply:
    """A supply of the nominal voltage of the first servo that it feeds."""

    def __init__(self) -> None:
        self._servos: list[Servo] = []
        self._last = (-1, 0.0)

    def feed(self, servo: Servo) -> None:
        """Feed one more servo."""
        self._servos.append(servo)

    def voltage(self, time: int) -> float:
        """Return the voltage (V) at `time` (ns)."""
        if time != self._last[0]:
            load = sum(abs(servo.state(time).load) for servo in self._servos)
            self._last = time, self._servos[0].model.nominal_voltage - SAG * load
        return self._last[1]
