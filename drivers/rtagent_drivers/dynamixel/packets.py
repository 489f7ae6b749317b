"""What both Dynamixel protocols have in common: packets, instructions, and what a codec does. No I/O here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, TypeVar

from rtagent.errors import SpecError

BROADCAST = 0xFE
Packet_co = TypeVar("Packet_co", covariant=True)


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


@dataclass(frozen=True, slots=True)
class Request:
    """A packet to servos: `servo` is an id, or BROADCAST."""

    servo: int
    instruction: int
    parameters: bytes = b""


@dataclass(frozen=True, slots=True)
class Status:
    """A servo's answer: `error` is the protocol's own error byte."""

    servo: int
    error: int
    parameters: bytes = b""


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of one servo's control table."""

    servo: int
    address: int
    length: int


@dataclass(frozen=True, slots=True)
class Write:
    """What is to be written to one servo's control table, from `address` on."""

    servo: int
    address: int
    data: bytes


class Decoder(Protocol[Packet_co]):
    """Finds packets in a stream of bytes that may hold anything; never raises for what comes in."""

    damaged: int
    """Packets that were cut short, or whose checksum was wrong."""
    skipped: int
    """Bytes that belong to no packet."""
    longest: int
    """No packet of more bytes than this is believed. Who knows what may come can set it lower: then noise that
    looks like the beginning of a long packet holds up nothing."""

    def feed(self, data: bytes) -> Sequence[Packet_co]:
        """Take further bytes; return the packets that they complete, in order."""

    def reset(self) -> Sequence[Packet_co]:
        """Give up waiting for the rest of a packet, as after a deadline; return those after its start."""


class Codec(Protocol):
    """A protocol: bytes of packets, and packets of bytes. Raises `SpecError` for what no packet can say."""

    protocol: int
    """1 or 2."""

    def request(self, request: Request) -> bytes:
        """Return the bytes of a request."""

    def status(self, status: Status) -> bytes:
        """Return the bytes of an answer (what emulators send)."""

    def status_length(self, parameters: int) -> int:
        """Return how many bytes an answer with so many bytes of parameters takes (2.0: before stuffing)."""

    def status_decoder(self) -> Decoder[Status]:
        """Return a decoder of answers, as a host needs it."""

    def request_decoder(self) -> Decoder[Request]:
        """Return a decoder of requests, as a servo needs it."""

    def read(self, span: Span) -> Request:
        """Return the request that reads a span of one servo."""

    def write(self, write: Write, *, registered: bool = False) -> Request:
        """Return the request that writes to one servo: at once, or, `registered`, when ACTION comes."""

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> Request:
        """Return the request that writes `data`, all of one length, by servo, to one address of several servos."""

    def group_read(self, spans: Sequence[Span]) -> Request:
        """Return the request that reads a span of each of several servos in one go; each answers by itself.

        A bulk read in 1.0 (one servo alone is simply read); in 2.0 a sync read where all spans are alike, else
        a bulk read. Each servo waits until it has seen the answer of the one before it.
        """

    def spans(self, request: Request) -> Sequence[Span]:
        """Return what a request reads, in the order of the answers: none where it reads nothing."""

    def writes(self, request: Request) -> Sequence[Write]:
        """Return what a request writes (also a registered one): none where it writes nothing."""


def check(servo: int, code: int, highest_id: int) -> None:
    """Raise `SpecError` unless a packet can bear this id (BROADCAST too), and this instruction or error."""
    if not (0 <= servo <= highest_id or servo == BROADCAST):
        raise SpecError(f"{servo} is no id of a servo: use 0 to {highest_id}, or {BROADCAST} for all at once.")
    if not 0 <= code <= 0xFF:
        raise SpecError(f"{code} is no instruction and no error: they are one byte, 0 to 255.")


def fits(parameters: bytes, longest: int) -> bytes:
    """Return `parameters`; raise `SpecError` where they are more than `longest` bytes."""
    if len(parameters) > longest:
        raise SpecError(f"{len(parameters)} bytes of parameters are more than the {longest} of a packet: split it.")
    return parameters


def equal_length(data: Mapping[int, bytes]) -> int:
    """Return how many bytes each servo gets; raise `SpecError` where that is not the same for all."""
    lengths = {len(value) for value in data.values()}
    if len(lengths) != 1:
        raise SpecError(f"a sync write gives each servo as many bytes, not {sorted(lengths)}: send several.")
    return lengths.pop()


def each_once(servos: Sequence[int]) -> None:
    """Raise `SpecError` where a servo is named twice, or none is."""
    if not servos or len(set(servos)) != len(servos):
        raise SpecError(f"a group names each of its servos once, not {list(servos)}: read the others separately.")
