"""The settings of a board, and what follows from them: the device's spec, and what its pins mean."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, pi
from typing import Any, ClassVar, Literal

from rtagent.errors import SpecError, did_you_mean
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Angle, AngularVelocity, Baud, Duration, Frequency, describe, ms, second, us
from rtagent_drivers.arduino.layouts import LAYOUTS, Format, Layout, is_switch
from rtagent_drivers.arduino.messages import LARGEST_READING
from rtagent_drivers.fake import CLOSED_SETTINGS, Faults

Stop = Literal["detach", "hold"]
"""What making safe means: no pulses, so that a servo goes limp, or the pulses that it has now."""

EXACT = 2_000_000
"""An AVR at 16 MHz has this rate, and whole fractions of it."""

BITS_A_BYTE, FULL_LINE = 10, 0.95
FRAME_BYTES = 11
"""A frame beside its readings: mark, type, number, time, CRC, and the zero at its end."""

SHORTEST_PULSE, LONGEST_PULSE = 500 * us, 2400 * us
LONGEST_HEARTBEAT = 60 * second


@dataclass(frozen=True)
class Channel:
    """What is on a pin: readings from 0 to 1023 mean `low` to `high`, in `unit`. A digital pin is true or false.

    `pin` is "A3" or "2", or the name of a field of a legacy line, such as "FSR1"; without it the channel is called
    as its pin is. `inverted`: a switch that is true where the pin reads 0, as with a pull-up resistor.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    pin: str = ""
    low: float = 0.0
    high: float = 1.0
    unit: str = ""
    inverted: bool = False

    def __post_init__(self) -> None:
        if not (isfinite(self.low) and isfinite(self.high)) or self.low == self.high:
            raise SpecError(f"a channel reads from {self.low} to {self.high}: give two different numbers.")


@dataclass(frozen=True)
class Servo:
    """A hobby servo: on which pin, and which angles (`range`) belong to which `pulses`.

    It is commanded within `low` … `high` (without them: the whole range), no faster than `max_velocity` (0: as fast
    as it can). It begins an episode at `start`; where it is before its first command, nobody knows.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    pin: int
    range: tuple[Angle, Angle] = (0.0, pi)
    pulses: tuple[Duration, Duration] = (544 * us, 2400 * us)
    low: Angle | None = None
    high: Angle | None = None
    max_velocity: AngularVelocity = 0.0
    start: Angle | None = None

    def __post_init__(self) -> None:
        shortest, longest = sorted(self.pulses)
        if not SHORTEST_PULSE <= shortest < longest <= LONGEST_PULSE:
            raise SpecError(
                f"pulses are {' to '.join(map(describe, self.pulses))}: "
                f"give two that differ, within {describe(SHORTEST_PULSE)} to {describe(LONGEST_PULSE)}."
            )
        if not self.range[0] < self.range[1]:
            raise SpecError(
                "range is [least, greatest angle]: swap the pulses where the servo turns the other way."
            )
        if not self.range[0] <= self.least < self.greatest <= self.range[1]:
            raise SpecError(
                "nothing is left between low and high: give two angles, in this order, within the range."
            )
        if self.start is not None and not self.least <= self.start <= self.greatest:
            raise SpecError(f"start is {self.start:g} rad, outside {self.least:g} to {self.greatest:g}.")
        if self.max_velocity < 0.0:
            raise SpecError("max_velocity is negative: give 0 or more.")

    @property
    def least(self) -> float:
        """The least angle (rad) that it is sent to."""
        return self.range[0] if self.low is None else self.low

    @property
    def greatest(self) -> float:
        """The greatest angle (rad) that it is sent to."""
        return self.range[1] if self.high is None else self.high

    def fraction(self, angle: float) -> float:
        """Return where in its range an angle is, 0 to 1."""
        return (angle - self.range[0]) / (self.range[1] - self.range[0])

    def pulse(self, angle: float) -> int:
        """Return the pulse (µs) of an angle."""
        first, last = self.pulses
        return round((first + (last - first) * self.fraction(angle)) / us)


@dataclass(frozen=True)
class FakeSettings:
    """How the driver's fakes behave.

    `body` is what is on the pins: a hand whose joints follow its servos, or, of the grasping experiment, the hand
    that is grasping by itself, or the glove (without it: a hand where there are servos, else a glove). `faults` are
    those of a fake in the process, `wire` those of an emulated board (see `rtagent emulate`), each as JSON; `drift`
    says by how much the emulated clock is fast.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    body: Literal["", "hand", "grasping", "glove"] = ""
    drift: float = 0.0
    faults: Faults = field(default_factory=Faults)
    wire: tuple[str, ...] = ()


@dataclass(frozen=True)
class Settings:
    """All settings of a board, checked against each other; raises `SpecError`."""

    port: str
    format: Format = "rtagent"
    baud: Baud | Literal["usb"] | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)
    servos: Mapping[str, Servo] = field(default_factory=dict)
    rate: Frequency | None = None
    heartbeat: Duration = 200 * ms
    stop: Stop = "detach"
    fake: FakeSettings = FakeSettings()

    def __post_init__(self) -> None:
        if not 0.0 < self.hertz <= 5_000.0:
            raise SpecError(f"rate is {self.hertz:g} Hz: give how often the channels are measured, up to 5kHz.")
        _check_channels(self)
        _check_servos(self)
        if self.format == "rtagent":
            check_baud(self.bits)
            check_load(len(self.inputs), self.hertz, 0 if self.baud == "usb" else self.bits)

    @classmethod
    def of(cls, **given: Any) -> Settings:
        """Return settings; what is None is left to its default."""
        return cls(**{name: value for name, value in given.items() if value is not None})

    @property
    def layout(self) -> Layout:
        """The format that the board speaks."""
        return LAYOUTS[self.format]

    @property
    def hertz(self) -> float:
        """How often (Hz) the channels are measured."""
        return self.layout.rate if self.rate is None else self.rate

    @property
    def period(self) -> int:
        """The time (ns) from one scan to the next."""
        return round(second / self.hertz / us) * us

    @property
    def bits(self) -> int:
        """The rate (bit/s) of the line; native USB takes any."""
        return self.layout.baud if self.baud in (None, "usb") else int(self.baud or 0)

    @property
    def inputs(self) -> Mapping[str, Channel]:
        """The channels; those of a legacy format are known without being named."""
        if self.channels or not self.layout.legacy:
            return self.channels
        return {pin: Channel(pin) for pin in self.layout.channels}

    @property
    def body(self) -> str:
        """What is on the pins of a fake."""
        return self.fake.body or ("hand" if self.servos else "glove")

    @property
    def pins(self) -> Sequence[str]:
        """The pin of each channel."""
        return [channel.pin or name for name, channel in self.inputs.items()]

    def spec(self) -> DeviceSpec:
        """Return what the board senses and takes."""
        sensors = {
            name: Spec.flag()
            if is_switch(pin)
            else Spec(unit=channel.unit, low=min(channel.low, channel.high), high=max(channel.low, channel.high))
            for (name, channel), pin in zip(self.inputs.items(), self.pins, strict=True)
        }
        actuators = {
            actuator(name): Spec(unit="rad", low=servo.least, high=servo.greatest)
            for name, servo in self.servos.items()
        }
        return DeviceSpec(sensors, actuators, self.hertz)


def actuator(servo: str) -> str:
    """Return the name of what a servo is commanded by."""
    return f"{servo}_position"


def value(channel: Channel, pin: str, reading: Any) -> Any:
    """Return what a reading means, or each of an array of them."""
    if is_switch(pin):
        return (reading != 0) != channel.inverted
    return channel.low + (channel.high - channel.low) * (reading / LARGEST_READING)


def check_baud(bits: int) -> None:
    """Raise `SpecError` for a rate that an AVR at 16 MHz does not have exactly."""
    if bits <= 0 or EXACT % bits:
        raise SpecError(
            f"a board at 16 MHz does not have {bits} baud exactly: take 250kbaud, 500kbaud, 1Mbaud or 2Mbaud, "
            "in the sketch too."
        )


def check_load(channels: int, rate: float, bits: int) -> None:
    """Raise `SpecError` where so many scans a second do not go through the line (0 bit/s: native USB)."""
    needed = (FRAME_BYTES + 2 * channels) * BITS_A_BYTE * rate
    if bits and needed > FULL_LINE * bits:
        raise SpecError(
            f"{channels} channels at {rate:g} Hz are {FRAME_BYTES + 2 * channels} bytes × {BITS_A_BYTE} bits × "
            f"{rate:g} Hz = {needed / 1000:.0f} kbit/s, too much for {bits} baud: lower the rate, or raise baud."
        )


def _check_channels(settings: Settings) -> None:
    if not settings.inputs:
        raise SpecError('name the channels, such as channels.thumb = { pin = "A0" }.')
    known = settings.layout.channels
    for name, pin in zip(settings.inputs, settings.pins, strict=True):
        if known and pin not in known:
            raise SpecError(
                f"{name}: the format {settings.format!r} has no {pin!r}{did_you_mean(pin, list(known))}"
            )
        if not known and not (pin.isdigit() or (pin[:1] == "A" and pin[1:].isdigit() and int(pin[1:]) < 16)):
            raise SpecError(f'{name}: {pin!r} is no pin: give one such as "A0", or "2".')
        if settings.inputs[name].inverted and not is_switch(pin):
            raise SpecError(f"{name}: only a switch can be inverted: swap low and high.")
    _once("channels", settings.pins)


def _check_servos(settings: Settings) -> None:
    servos = settings.servos
    _once("servos", [servo.pin for servo in servos.values()])
    if servos and not 10 * ms <= settings.heartbeat <= LONGEST_HEARTBEAT:
        raise SpecError(f"heartbeat is {describe(settings.heartbeat)}: give 10ms to 60s.")
    if not servos or not settings.layout.legacy:
        return
    if {servo.pin for servo in servos.values()} != set(settings.layout.servos):
        there = ", ".join(map(str, settings.layout.servos)) or "none"
        raise SpecError(f"the format {settings.format!r} moves all its servos at once: name those on pins {there}.")
    if settings.stop != "hold":
        raise SpecError("a legacy sketch cannot let go of its servos: give stop = hold, or upload firmware/hand.")
    if any(servo.start is None for servo in servos.values()):
        raise SpecError("a legacy sketch moves all its servos at once: give each a start.")


def _once(what: str, pins: Iterable[object]) -> None:
    seen: set[object] = set()
    for pin in pins:
        if pin in seen:
            raise SpecError(f"two {what} are on pin {pin}: each has a pin of its own.")
        seen.add(pin)
