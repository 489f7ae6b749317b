"""The driver's two fakes: a board that is a function of time, and the driver itself on an emulated board.

Both take the driver's settings, and obey its limits by its own code.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import weakref
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from tempfile import gettempdir
from typing import Any
from uuid import uuid4

from numpy.random import Generator

from rtagent.device import LastResort
from rtagent.errors import DeviceError
from rtagent.experience import Command, Stimulus, Values
from rtagent.specs import Value
from rtagent_drivers.arduino.bodies import BODIES, FASTEST, Body
from rtagent_drivers.arduino.device import Arduino, ArduinoWithServos
from rtagent_drivers.arduino.servos import Ramp
from rtagent_drivers.arduino.settings import Servo, Settings, actuator, value
from rtagent_drivers.fake import FakeDevice, Sampling

EMULATOR = "rtagent_drivers.arduino.emulated.pty"
LINGER = "2s"
"""So long the emulated board outlives a process that died: long enough to be made safe from outside."""


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

    def _turn(self, now: int, name: str, goal: float) -> None:
        servo = self._servos[name]
        self._ramps[name].go(goal, now)
        self._body.turn(now, self._numbers[name], servo.fraction(goal), _speed(servo))


def _speed(servo: Servo) -> float:
    """Return how many of its ranges a servo may go in a second."""
    return servo.max_velocity / (servo.range[1] - servo.range[0]) if servo.max_velocity else FASTEST


class FakeBoard(FakeDevice):
    """A board in the process; as the driver, it brings commands within their range."""

    async def act(self, command: Command) -> Command:
        """Hand a command to the world; return what became of it."""
        return await super().act({name: self._within(name, goal) for name, goal in command.items()})

    def _within(self, name: str, goal: Value) -> Value:
        spec = self.spec.actuators.get(name)
        if spec is None or not isinstance(goal, int | float) or not isfinite(goal):
            return goal
        return spec.clip(goal)


def in_process(**given: Any) -> FakeBoard:
    """Return a board with the driver's settings that needs no wire, and works under the virtual clock."""
    settings = Settings.of(**given)
    world = BoardWorld(settings, BODIES[settings.body]())
    return FakeBoard(world, Sampling(settings.hertz), settings.fake.faults)


class Emulation:
    """An emulated board in a process of its own; it begins when it is needed, and ends with this object."""

    def __init__(self, settings: Settings) -> None:
        self.link = Path(gettempdir()) / f"rtagent-{uuid4().hex}"
        self._command = _command(settings, self.link)
        self._process: subprocess.Popen[str] | None = None

    async def begin(self) -> None:
        """Begin it; raise `DeviceError` with what it says where it ends at once."""
        if self._process is None:
            self._process = await asyncio.to_thread(_started, self._command)
            weakref.finalize(self, _end, self._process)

    def tell(self, **order: Any) -> None:
        """Give it an order while it runs (see `rtagent emulate handi --help`)."""
        if self._process is None or self._process.stdin is None:
            raise DeviceError("the emulated board does not run yet: open the device first.")
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()


class EmulatedArduino(Arduino):
    """The driver on an emulated board."""

    def __init__(self, settings: Settings) -> None:
        self.emulation = Emulation(settings)
        super().__init__(replace(settings, port=str(self.emulation.link)))

    async def open(self) -> None:
        """Connect to the emulated board; the first time, begin it."""
        await self.emulation.begin()
        await super().open()


class EmulatedArduinoWithServos(ArduinoWithServos):
    """The driver on an emulated board that moves."""

    def __init__(self, settings: Settings) -> None:
        self.emulation = Emulation(settings)
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


def _command(settings: Settings, link: Path) -> list[str]:
    board = "glovi" if settings.body == "glove" else "handi"
    command = [sys.executable, "-m", EMULATOR, board, "--link", str(link), "--linger", LINGER]
    command += ["--body", settings.body]
    command += ["--format", settings.format, "--rate", f"{settings.hertz!r}Hz", "--baud", f"{settings.bits}baud"]
    command += ["--drift", repr(settings.fake.drift)]
    if not settings.layout.legacy:
        servos = ",".join(str(servo.pin) for servo in settings.servos.values())
        command += ["--channels", ",".join(settings.pins), "--servos", servos]
    return command + [each for fault in settings.fake.wire for each in ("--fault", fault)]


def _started(command: Sequence[str]) -> subprocess.Popen[str]:
    """Return the emulator's process once its link is there; raise `DeviceError` with what it says where it ends."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(  # noqa: S603  # our own module, with our own Python
        command,
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,  # Ctrl-C is not for it
    )
    assert process.stdout is not None, "it was asked for"
    if not process.stdout.readline():
        _, said = process.communicate()
        raise DeviceError(f"the emulated board did not begin: {said.strip()}")
    return process


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    process.communicate()
