"""Servos as motors with a gearbox: what voltage a torque takes, what heat it leaves, and how warm that makes them.

All is as seen at the output, in SI units. The MX-64 and the MX-106 are as they were identified on a pendulum
(Duclusaud, Passault, Padois and Ly 2024, Extended friction models for the physics simulation of servo actuators;
Coulomb and viscous friction, model M1). Of the MX-28, which they did not measure, constant and resistance follow
from its no-load speed and stall current at 12 V (ROBOTIS e-Manual), friction and inertia are those of an MX-64 in
the proportion of the stall torques (2.5 to 6.0 Nm). Masses and sizes are from the e-Manual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from rtagent.experience import FloatArray

SUPPLY = 12.0
"""Volts."""
STANDBY = 0.1 * SUPPLY
"""Watts that a servo's electronics take (e-Manual: 100 mA)."""
STIFFNESS = 32 * 0.158
"""Duty cycle for each rad that a joint is off its goal: the factory's P gain, times what Duclusaud measured."""

AMBIENT = 23.0
"""°C."""
EXCHANGE = 10.0
"""W/(m² K) from a small case to still air, by convection and radiation (Incropera and DeWitt 2002)."""
SPECIFIC_HEAT = 900.0
"""J/(kg K): aluminium's, and nearly that of the plastic and steel beside it."""
SMOOTH = 0.05
"""Friction turns round within about this speed (rad/s)."""


@dataclass(frozen=True)
class Motor:
    """A servo: Nm/A (and V s/rad), ohm, kg m², Nm, Nm s/rad, kg, and the sides of its case (m)."""

    model: str
    constant: float
    resistance: float
    armature: float
    friction: float
    viscosity: float
    mass: float
    sides: tuple[float, float, float]

    @property
    def conductance(self) -> float:
        """How much heat its case gives off (W/K)."""
        a, b, c = self.sides
        return EXCHANGE * 2.0 * (a * b + b * c + c * a)

    @property
    def cooling_time(self) -> float:
        """Its thermal time constant (s)."""
        return self.mass * SPECIFIC_HEAT / self.conductance


MX_64 = Motor("MX-64", 1.622, 3.949, 0.01195, 0.0904, 0.0117, 0.135, (0.0402, 0.0611, 0.041))
MX_106 = Motor("MX-106", 2.191, 2.965, 0.02661, 0.1035, 0.0352, 0.153, (0.0402, 0.0651, 0.046))
LIGHTER = 2.5 / 6.0
MX_28 = Motor(
    "MX-28",
    SUPPLY / (55 * 2 * pi / 60),
    SUPPLY / 1.4,
    LIGHTER * MX_64.armature,
    LIGHTER * MX_64.friction,
    LIGHTER * MX_64.viscosity,
    0.077,
    (0.0356, 0.0506, 0.0355),
)


class Drives:
    """Several motors at once: arrays of shape (…, motors)."""

    def __init__(self, motors: Sequence[Motor]) -> None:
        self.constant = np.array([motor.constant for motor in motors])
        self.resistance = np.array([motor.resistance for motor in motors])
        self.armature = np.array([motor.armature for motor in motors])
        self.friction = np.array([motor.friction for motor in motors])
        self.viscosity = np.array([motor.viscosity for motor in motors])
        self.conductance = np.array([motor.conductance for motor in motors])
        self.cooling_time = np.array([motor.cooling_time for motor in motors])

    def torque(self, outside: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return what the motors have to give (Nm) for a motion against what acts from outside, and friction."""
        rubbing = self.friction * np.tanh(velocity / SMOOTH) + self.viscosity * velocity
        torque: FloatArray = outside + self.armature * acceleration + rubbing
        return torque

    def duty(self, torque: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the part of the supply's voltage that gives a torque at a speed: V = R τ / k + k ω."""
        duty: FloatArray = (self.resistance * torque / self.constant + self.constant * velocity) / SUPPLY
        return duty

    def torque_at_rest(self, duty: FloatArray) -> FloatArray:
        """Return the torque (Nm) that a part of the supply's voltage gives a joint that cannot move."""
        torque: FloatArray = duty * SUPPLY * self.constant / self.resistance
        return torque

    def tends_to(self, torque: FloatArray) -> FloatArray:
        """Return the temperatures (°C) that they would reach at these torques: I² R and the electronics' heat."""
        heat = (torque / self.constant) ** 2 * self.resistance + STANDBY
        warmth: FloatArray = AMBIENT + heat / self.conductance
        return warmth

    def warmed(self, before: FloatArray, tends_to: FloatArray, step: float) -> FloatArray:
        """Return the temperatures at every step (s), shape (steps, motors), from those `before` the first.

        That is the first-order law, solved exactly where what they tend to changes from step to step.
        """
        steps = np.arange(len(tends_to))[:, None]
        kept = np.exp(-step / self.cooling_time)
        gained = (1.0 - kept) * tends_to / kept ** (steps + 1)
        total = np.concatenate((np.zeros((1, len(kept))), np.cumsum(gained, axis=0)[:-1]))
        temperatures: FloatArray = kept**steps * (before + total)
        return temperatures
