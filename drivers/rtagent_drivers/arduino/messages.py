"""What boards say, in whichever format; and what makes messages of bytes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol

LARGEST_READING = 1023
"""What the converter of an AVR reads at its supply voltage."""


class Scan(NamedTuple):
    """Readings of all channels, 0 to 1023, or 0 and 1 where a channel is digital.

    `number` counts scans in 16 bits, `micros` is the board's time (µs) in 32 bits; legacy formats have neither.
    """

    readings: tuple[int, ...]
    number: int | None = None
    micros: int | None = None


class Hello(NamedTuple):
    """What a board is: the pins of its channels ("A0", "2") and servos. Times in ns.

    `started`: it has just been reset. A scan takes `scan`, and is sent `lag` after its middle, which is its time.
    After `heartbeat` of silence it makes its servos safe.
    Of a board of another `version` nothing else is known.
    """

    version: int
    started: bool = False
    period: int = 0
    scan: int = 0
    lag: int = 0
    heartbeat: int = 0
    holds: bool = False
    channels: tuple[str, ...] = ()
    servos: tuple[int, ...] = ()


class Safety(IntEnum):
    """Whether a board's servos are safe, and why."""

    MOVING = 0
    TOLD_TO = 1
    UNHEARD = 2


class ServoState(NamedTuple):
    """Whether the servos are safe, how many frames came damaged to the board, and the pulses (µs; 0: none)."""

    safety: int
    bad: int
    pulses: tuple[int, ...]


Message = Scan | Hello | ServoState


class Decoder(Protocol):
    """Makes messages of bytes as they come, in pieces of any size."""

    bad: int
    """How many frames or lines were damaged, apart from the first, which may have begun before we listened."""

    def feed(self, data: bytes, /) -> Sequence[Message]:
        """Take bytes; return the messages that are complete with them."""
