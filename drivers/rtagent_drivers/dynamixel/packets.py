"""What both Dynamixel protocols have in common: packets, instructions, and what a codec does. No I/O here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

BROADCAST = 0xFE


class Instruction(IntEnum):
    """What a packet asks of a servo; STATUS is the answer (protocol 2.0; in 1.0 an answer bears no instruction)."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    CONTROL_TABLE_BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


@dataclass(frozen=True)
class Request:
    """A packet to servos: `servo` is an id, or BROADCAST."""

    servo: int
    instruction: int
    parameters: bytes = b""


@dataclass(frozen=True)
class Status:
    """A servo's answer: `error` is the protocol's own error byte."""

    servo: int
    error: int
    parameters: bytes = b""


@dataclass(frozen=True)
class Span:
    """A stretch of one servo's control table."""

    servo: int
    address: int
    length: int


class Decoder(Protocol):
    """Finds packets in a stream of bytes that may hold anything; never raises for what comes in."""

    damaged: int
    """Packets whose checksum was wrong, or whose length cannot be."""
    skipped: int
    """Bytes that belong to no packet."""

    def feed(self, data: bytes) -> Sequence[Request | Status]:
        """Take further bytes; return the packets that they complete, in order."""

    def reset(self) -> None:
        """Forget what has come of a packet so far: after a deadline the rest of it will not come."""


class Codec(Protocol):
    """A protocol: bytes of packets, and packets of bytes. Raises `SpecError` for what no packet can say."""

    protocol: int
    """1 or 2."""

    def request(self, request: Request) -> bytes:
        """Return the bytes of a request."""

    def status(self, status: Status) -> bytes:
        """Return the bytes of an answer (what emulators send)."""

    def status_decoder(self) -> Decoder:
        """Return a decoder of answers (`Status`), as a host needs it."""

    def request_decoder(self) -> Decoder:
        """Return a decoder of requests (`Request`), as a servo needs it."""

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> Request:
        """Return the request that writes `data`, all of one length, by servo, to one address of several servos."""

    def group_read(self, spans: Sequence[Span]) -> Request:
        """Return the request that reads a span of each of several servos in one go; each answers by itself.

        It is a bulk read in 1.0; in 2.0 a sync read where all spans are alike, else a bulk read.
        """
