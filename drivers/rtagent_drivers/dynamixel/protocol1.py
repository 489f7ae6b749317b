"""Dynamixel protocol 1.0: `FF FF id length instruction|error parameters checksum`.

Source: https://emanual.robotis.com/docs/en/dxl/protocol1/
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, TypeVar

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel.packets import (
    BROADCAST,
    Decoder,
    Instruction,
    Request,
    Span,
    Status,
    Write,
    check,
    each_once,
    equal_length,
    fits,
)
from rtagent_drivers.dynamixel.stream import StreamDecoder

Packet = TypeVar("Packet")

HEADER = b"\xff\xff"
WHOLE = (0xFF + sum(HEADER)) & 0xFF
"""The last byte of the sum over a good packet: the checksum makes it FF without the header."""

HIGHEST_ID = 0xFD
LONGEST = 253
"""Bytes of parameters: the length, two more, is one byte."""


class Framing(Generic[Packet]):
    """How packets begin and end; `highest` are the highest id and the highest code that they can bear."""

    header = HEADER
    shortest = 5
    longest = LONGEST + 6

    def __init__(self, make: Callable[[int, int, bytes], Packet], highest: tuple[int, int]) -> None:
        self._make, (self._servo, self._code) = make, highest

    def end(self, buffer: bytes, start: int) -> int:
        """Return where the packet ends whose header is at `start`; `start` itself where it can be none."""
        length = buffer[start + 3]
        possible = buffer[start + 2] <= self._servo and buffer[start + 4] <= self._code and length >= 2
        return start + 4 + length if possible else start

    def cut_short(self, buffer: bytes, start: int) -> bool:
        """Return False: parameters may look like anything, so only time tells."""
        return False

    def parse(self, frame: bytes) -> Packet | None:
        """Return the packet, or None where its checksum is wrong."""
        if sum(frame) & 0xFF != WHOLE:
            return None
        return self._make(frame[2], frame[4], frame[5:-1])


STATUS = Framing(Status, (HIGHEST_ID, 0x7F))
REQUEST = Framing(Request, (BROADCAST, 0xFF))


class Protocol1:
    """The codec of protocol 1.0."""

    protocol = 1

    def request(self, request: Request) -> bytes:
        """Return the bytes of a request."""
        return _frame(request.servo, request.instruction, request.parameters)

    def status(self, status: Status) -> bytes:
        """Return the bytes of an answer."""
        return _frame(status.servo, status.error, status.parameters)

    def status_length(self, parameters: int) -> int:
        """Return how many bytes an answer with so many bytes of parameters takes."""
        return 6 + parameters

    def status_decoder(self) -> Decoder[Status]:
        """Return a decoder of answers. An echo of a request looks like an answer too: ask only where none is."""
        return StreamDecoder(STATUS)

    def request_decoder(self) -> Decoder[Request]:
        """Return a decoder of requests."""
        return StreamDecoder(REQUEST)

    def read(self, span: Span) -> Request:
        """Return the request that reads a span of one servo."""
        return Request(span.servo, Instruction.READ, _bytes(span.address, span.length))

    def write(self, write: Write, *, registered: bool = False) -> Request:
        """Return the request that writes to one servo: at once, or, `registered`, when ACTION comes."""
        instruction = Instruction.REG_WRITE if registered else Instruction.WRITE
        return Request(write.servo, instruction, _bytes(write.address) + write.data)

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> Request:
        """Return the request that writes `data`, all of one length, by servo, to one address of several servos."""
        parts = [_bytes(address, equal_length(data))]
        parts += [_bytes(servo) + value for servo, value in data.items()]
        return Request(BROADCAST, Instruction.SYNC_WRITE, b"".join(parts))

    def group_read(self, spans: Sequence[Span]) -> Request:
        """Return the bulk read of a span of each of several servos (not of the AX series); each answers by itself.

        A servo waits for the answer of the one before it; for one alone it is a plain read.
        """
        each_once([span.servo for span in spans])
        if len(spans) == 1:
            return self.read(spans[0])
        parts = [_bytes(span.length, span.servo, span.address) for span in spans]
        return Request(BROADCAST, Instruction.BULK_READ, b"\0" + b"".join(parts))

    def spans(self, request: Request) -> Sequence[Span]:
        """Return what a request reads, in the order of the answers: none where it reads nothing."""
        data = request.parameters
        if request.instruction == Instruction.READ:
            return [Span(request.servo, *_whole(data, 2))]
        if request.instruction == Instruction.BULK_READ:
            groups = (data[at : at + 3] for at in range(1, len(data), 3))
            return [Span(servo, address, length) for length, servo, address in (_whole(g, 3) for g in groups)]
        return []

    def writes(self, request: Request) -> Sequence[Write]:
        """Return what a request writes (also a registered one): none where it writes nothing."""
        data = request.parameters
        if request.instruction in (Instruction.WRITE, Instruction.REG_WRITE):
            return [Write(request.servo, _whole(data[:1], 1)[0], data[1:])]
        if request.instruction == Instruction.SYNC_WRITE:
            address, length = _whole(data[:2], 2)
            groups = (_whole(data[at : at + 1 + length], 1 + length) for at in range(2, len(data), 1 + length))
            return [Write(group[0], address, group[1:]) for group in groups]
        return []


PROTOCOL1 = Protocol1()


def _frame(servo: int, code: int, parameters: bytes) -> bytes:
    check(servo, code, HIGHEST_ID)
    body = bytes((servo, len(fits(parameters, LONGEST)) + 2, code)) + parameters
    return HEADER + body + bytes((~sum(body) & 0xFF,))


def _bytes(*values: int) -> bytes:
    if not all(0 <= value <= 0xFF for value in values):
        raise SpecError(f"protocol 1.0 has ids, addresses and lengths from 0 to 255, not {list(values)}.")
    return bytes(values)


def _whole(data: bytes, size: int) -> bytes:
    if len(data) != size:
        raise SpecError(f"the parameters end after {len(data)} of {size} bytes.")
    return data
