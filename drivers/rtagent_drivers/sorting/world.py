"""The sorting arm as a world: a session of trials, read as its servos would read it. It takes no commands."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec, Value
from rtagent.units import second
from rtagent_drivers.arm import noise_at
from rtagent_drivers.dynamixel.control_table import Register
from rtagent_drivers.dynamixel.models import by_name
from rtagent_drivers.dynamixel.values import bounds
from rtagent_drivers.sorting.servos import AMBIENT, STIFFNESS
from rtagent_drivers.sorting.trials import JOINTS, MOTORS, PLACES, STEP, Trial, trial

WEIGHTS = (0.05, 0.15, 0.3)
"""kg of the objects."""
ENDED = "ended"
ENCODER_NOISE = 0.03 * pi / 180
"""rad rms: the transition noise of the encoder (ams AS5045, data sheet)."""
RANGES = {
    "shoulder": (-1.5, 1.5),
    "elbow": (-0.8, 0.8),
    "wrist_rotation": (-1.0, 1.0),
    "wrist_flexion": (-0.8, 0.8),
    "hand": (0.0, 1.2),
}
"""rad: what the positions are declared to lie within."""
FASTEST, HOTTEST = 3.0, 80.0


class SortingWorld:
    """The arm carries each object so many `trials` times, in an order drawn at random, and then rests.

    `weights` are those of the objects (kg), the lightest first; without `wrist` the wrist is held. A state is a
    function of time: trials are computed when they are first asked for, each from how warm the one before left
    the servos.
    """

    def __init__(self, trials: int = 30, weights: Sequence[float] = WEIGHTS, *, wrist: bool = False) -> None:
        if trials < 1:
            raise SpecError(f"trials is {trials}: give how often each object is carried, 1 or more.")
        if len(weights) != len(PLACES) or not all(0 < weight <= 1 for weight in weights):
            raise SpecError(f"weights are {list(weights)}: give {len(PLACES)} of them in kg, above 0 and up to 1.")
        self._count, self._weights, self._wrist = trials, tuple(sorted(weights)), wrist
        self._servos = [_Servo(name, motor.model) for name, motor in zip(JOINTS, MOTORS, strict=True)]
        sensors = {name: spec for servo in self._servos for name, spec in servo.sensors.items()}
        self.spec = DeviceSpec(sensors=sensors | {ENDED: Spec.flag()})

    def begin(self, now: int, rng: Generator) -> None:
        """Begin the first trial, cold; all that is random follows from one number that is drawn from `rng`."""
        self._seed = int(rng.integers(1 << 63))
        objects = np.repeat(np.arange(len(self._weights)), self._count)
        self.objects: list[int] = np.random.default_rng((self._seed, 0)).permutation(objects).tolist()
        self._trials: list[Trial] = []
        self._starts = [now]

    def trial_at(self, time: int) -> int:
        """Return the number of the trial at `time` (ns), from 0; after the last one, how many there were."""
        while self._starts[-1] <= time and len(self._trials) < len(self.objects):
            self._add()
        return min(bisect_right(self._starts, time) - 1, len(self.objects))

    def values(self, time: int) -> Values:
        """Return what the servos read at `time` (ns)."""
        number = self.trial_at(time)
        over = number == len(self.objects)
        known = self._trials[number - over]
        place = len(known.goals) - 1.0 if over else (time - self._starts[number]) / second / STEP
        values: dict[str, Value] = {}
        for joint, (servo, felt) in enumerate(zip(self._servos, _between(known, place), strict=True)):
            wobble = noise_at(self._seed, time, joint)[0] * sqrt(3.0) * ENCODER_NOISE
            values.update(servo.read(*felt, wobble))
        return values | {ENDED: over}

    def command(self, now: int, command: Command) -> Command:
        """Take no command: it has no actuators."""
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: nothing calls for a reaction."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return when the next trial begins, or the last one ends; None after that."""
        following = self.trial_at(now) + 1
        return self._starts[following] if following < len(self._starts) else None

    def make_safe(self, now: int) -> None:
        """Do nothing: what it does by itself is part of the world."""

    def save(self) -> Saved:
        """Return nothing: all follows from when and from what it began."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""

    def _add(self) -> None:
        number = len(self._trials)
        carried = self.objects[number]
        before = self._trials[-1].temperatures[-1] if self._trials else np.full(len(JOINTS), AMBIENT)
        rng = np.random.default_rng((self._seed, 1 + number))
        made = trial(PLACES[carried], self._weights[carried], before, rng, wrist=self._wrist)
        self._trials.append(made)
        self._starts.append(self._starts[-1] + round(made.lasts * second))


class _Servo:
    """What a servo tells of its joint, in whole counts of its registers."""

    def __init__(self, name: str, model: str) -> None:
        registers = by_name(model).registers
        self._position, self._velocity = (
            _Counts(registers["present_position"]),
            _Counts(registers["present_velocity"]),
        )
        self._load, self._temperature = (
            _Counts(registers["present_load"]),
            _Counts(registers["present_temperature"]),
        )
        low, high = RANGES[name]
        self.sensors = {
            f"{name}_position": Spec(unit="rad", low=low, high=high),
            f"{name}_velocity": Spec(unit="rad/s", low=-FASTEST, high=FASTEST),
            f"{name}_load": Spec(low=-1.0, high=1.0),
            f"{name}_temperature": Spec(unit="°C", low=0.0, high=HOTTEST),
        }

    def read(
        self, goal: float, position: float, velocity: float, temperature: float, wobble: float
    ) -> dict[str, float]:
        """Return position, velocity, load and temperature, the encoder being off by `wobble` (rad).

        The load is the controller's own output, which follows from how many counts the encoder is off the goal.
        """
        seen = self._position(position + wobble)
        load = self._load(STIFFNESS * (self._position(goal) - seen))
        measured = seen, self._velocity(velocity), load, self._temperature(temperature)
        return dict(zip(self.sensors, measured, strict=True))


class _Counts:
    """Rounds values to whole counts of a register, within its bounds."""

    def __init__(self, register: Register) -> None:
        self._scale, self._zero, (self._low, self._high) = register.scale, register.zero, bounds(register)

    def __call__(self, value: float) -> float:
        """Return what the register makes of a value."""
        count = round(value / self._scale) + self._zero
        return (min(max(count, self._low), self._high) - self._zero) * self._scale


def _between(known: Trial, place: float) -> Iterator[tuple[float, float, float, float]]:
    """Yield goal, position, velocity and temperature of each joint, `place` steps after the trial began."""
    first = min(int(place), len(known.goals) - 2)
    part = place - first
    series = (known.goals, known.positions, known.velocities, known.temperatures)
    at: Iterator[Any] = zip(
        *((each[first] + part * (each[first + 1] - each[first])).tolist() for each in series), strict=True
    )
    return at
