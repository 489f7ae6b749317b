"""The driver's two fakes: a board that is a function of time, and the driver itself on an emulated board.

Both take the driver's settings, and obey its limits by its own code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

from rtagent.device import LastResort
from rtagent.experience import Command, FloatArray, Stimulus, Values
from rtagent.saving import Saved, restore_parts, save_parts
from rtagent_drivers.arduino.bodies import BODIES, FASTEST, Body, Scanning
from rtagent_drivers.arduino.device import Arduino, ArduinoWithServos
from rtagent_drivers.arduino.servos import Ramp
from rtagent_drivers.arduino.settings import Servo, Settings, actuator, value
from rtagent_drivers.emulation.starting import Emulation
from rtagent_drivers.emulation.world_time import began_on_the_wire
from rtagent_drivers.fake import LimitedFake, Sampling
from rtagent_drivers.grasping.session import Times

EMULATOR = "rtagent_drivers.arduino.emulated.pty"


class BoardWorld:
    """A board and what is on its pins, as a world that needs no wire."""

    def __init__(self, settings: Settings, body: Body) -> None:
        self.spec = settings.spec()
        self._settings, self._body = settings, body
        self._servos = {actuator(name): servo for name, servo in settings.servos.items()}
        self._numbers = {name: number for number, name in enumerate(self._servos)}
        self._ramps = {name: Ramp(servo) for name, servo in self._servos.items()}

    def begin(self, now: int, rng: Generator) -> None:
        """Begin an episode; servos that have a start are there."""
        self._body.begin(now, rng)
        for ramp in self._ramps.values():
            ramp.forget()
        for name, servo in self._servos.items():
            if servo.start is not None:
                self._turn(now, name, servo.start)

    def values(self, time: int) -> Values:
        """Return what the channels read at `time`."""
        channels = zip(self._settings.inputs.items(), self._settings.pins, strict=True)
        return {name: value(channel, pin, self._body.reading(pin, time)) for (name, channel), pin in channels}

    def columns(self, times: Times) -> Mapping[str, FloatArray]:
        """Return what the channels read at these times (ns), shape (n,)."""
        read = self._readings(times)
        channels = zip(self._settings.inputs.items(), self._settings.pins, strict=True)
        return {name: value(channel, pin, read[pin]).astype(np.float64) for (name, channel), pin in channels}

    def command(self, now: int, command: Command) -> Command:
        """Send servos on their way; return where they go."""
        for name, goal in command.items():
            self._turn(now, name, float(goal))
        return dict(command)

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return none: what calls for a reaction is said by the events of a scenario."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return None: what is on the pins changes all the time, and is seen by scans."""
        return None

    def make_safe(self, now: int) -> None:
        """Let go of all servos, or have them stay."""
        holds = self._settings.stop == "hold"
        for name, ramp in self._ramps.items():
            held = self._servos[name].fraction(ramp.at(now)) if holds and ramp.known else None
            self._body.turn(now, self._numbers[name], held)

    def save(self) -> Saved:
        """Return where its servos go, and what has become of the body."""
        return {"body": self._body.save(), "ramps": save_parts(self._ramps)}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        self._body.restore(saved["body"])
        restore_parts(self._ramps, saved["ramps"])

    def _readings(self, times: Times) -> Mapping[str, Times]:
        pins, nothing = self._settings.pins, np.zeros(len(times), np.int64)
        if isinstance(self._body, Scanning):
            return dict.fromkeys(pins, nothing) | dict(self._body.scan(times))
        return {pin: np.array([self._body.reading(pin, time) for time in times.tolist()]) for pin in pins}

    def _turn(self, now: int, name: str, goal: float) -> None:
        servo = self._servos[name]
        self._ramps[name].go(goal, now)
        self._body.turn(now, self._numbers[name], servo.fraction(goal), _speed(servo))


def _speed(servo: Servo) -> float:
    """Return how many of its ranges a servo may go in a second."""
    return servo.max_velocity / (servo.range[1] - servo.range[0]) if servo.max_velocity else FASTEST


def in_process(**given: Any) -> LimitedFake:
    """Return a board with the driver's settings that needs no wire, and works under the virtual clock."""
    settings = Settings.of(**given)
    world = BoardWorld(settings, BODIES[settings.body]())
    return LimitedFake(world, Sampling(settings.hertz), settings.fake.faults)


class EmulatedArduino(Arduino):
    """The driver on an emulated board."""

    def __init__(self, settings: Settings) -> None:
        self.emulation = Emulation(EMULATOR, _arguments(settings))
        super().__init__(replace(settings, port=str(self.emulation.link)))

    async def open(self) -> None:
        """Connect to the emulated board; the first time, begin it."""
        await self.emulation.begin()
        await super().open()


class EmulatedArduinoWithServos(ArduinoWithServos):
    """The driver on an emulated board that moves."""

    def __init__(self, settings: Settings) -> None:
        self.emulation = Emulation(EMULATOR, _arguments(settings))
        super().__init__(replace(settings, port=str(self.emulation.link)))

    async def open(self) -> None:
        """Connect to the emulated board; the first time, begin it."""
        await self.emulation.begin()
        await super().open()

    def last_resort(self) -> LastResort:
        """Return how to make it safe without this process; it is no hardware that would stay latched."""
        return replace(super().last_resort(), hardware="")


def on_wire(**given: Any) -> Arduino:
    """Return the driver with these settings on an emulated board, on a pseudo-terminal."""
    settings = Settings.of(**given)
    return EmulatedArduinoWithServos(settings) if settings.servos else EmulatedArduino(settings)


def _arguments(settings: Settings) -> list[str]:
    told = ["glovi" if settings.body == "glove" else "handi", "--body", settings.body]
    told += ["--format", settings.format, "--rate", f"{settings.hertz!r}Hz", "--baud", f"{settings.bits}baud"]
    told += ["--drift", repr(settings.fake.drift), "--since", str(began_on_the_wire())]
    if not settings.layout.legacy:
        servos = ",".join(str(servo.pin) for servo in settings.servos.values())
        told += ["--channels", ",".join(settings.pins), "--servos", servos]
    return told + [each for fault in settings.fake.wire for each in ("--fault", fault)]
