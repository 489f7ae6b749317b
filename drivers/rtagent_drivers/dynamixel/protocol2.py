"""Dynamixel protocol 2.0: `FF FF FD 00 id length(2) instruction [error] parameters crc(2)`, little-endian.

Within a packet `FF FF FD` is followed by one more `FD` (stuffing), so that no header can stand there; the combined
answers of fast reads, whose servos must know beforehand where each begins, are not stuffed.
Source: https://emanual.robotis.com/docs/en/dxl/protocol2/
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from struct import Struct
from typing import Generic, TypeVar

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel.crc import crc16
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

HEADER = b"\xff\xff\xfd\x00"
HIGHEST_ID = 0xFC
LONGEST = 1024
"""The highest length (of all that follows it) that is believed: servos and the SDK keep no more."""

UNSTUFFED, STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
WORD = Struct("<H")
SYNC_READS = (Instruction.SYNC_READ, Instruction.FAST_SYNC_READ)
BULK_READS = (Instruction.BULK_READ, Instruction.FAST_BULK_READ)


class Framing(Generic[Packet]):
    """How packets begin and end: answers, or requests, which are all others."""

    header = HEADER
    shortest = 10
    longest = LONGEST + 7

    def __init__(self, make: Callable[[int, int, bytes], Packet], *, answers: bool) -> None:
        self._make, self._answers = make, answers
        self._code_at = 8 if answers else 7
        self._least = self._code_at - 4

    def end(self, buffer: bytes, start: int) -> int:
        """Return where the packet ends whose header is at `start`; `start` itself where it can be none."""
        length = buffer[start + 5] | buffer[start + 6] << 8
        ours = (buffer[start + 7] == Instruction.STATUS) == self._answers
        possible = ours and length >= self._least and buffer[start + 4] <= BROADCAST
        return start + 7 + length if possible else start

    def cut_short(self, buffer: bytes, start: int) -> bool:
        """Return whether another packet has begun within this one."""
        return not self._is_combined(buffer[start + 4]) and buffer.find(HEADER, start + 7) >= 0

    def parse(self, frame: bytes) -> Packet | None:
        """Return the packet, or None where its CRC is wrong."""
        if crc16(frame[:-2]) != frame[-2] | frame[-1] << 8:
            return None
        servo, code_at = frame[4], self._code_at
        content = frame[code_at:-2]
        if STUFFED in content and not self._is_combined(servo):
            content = unstuffed(content)
        return self._make(servo, content[0], content[1:])

    def _is_combined(self, servo: int) -> bool:
        return self._answers and servo == BROADCAST


STATUS = Framing(Status, answers=True)
REQUEST = Framing(Request, answers=False)


class Protocol2:
    """The codec of protocol 2.0."""

    protocol = 2

    def request(self, request: Request) -> bytes:
        """Return the bytes of a request."""
        check(request.servo, request.instruction, HIGHEST_ID)
        return _frame(request.servo, stuffed(bytes((request.instruction,)) + request.parameters))

    def status(self, status: Status) -> bytes:
        """Return the bytes of an answer; one from BROADCAST is the combined answer to a fast read."""
        check(status.servo, status.error, HIGHEST_ID)
        content = bytes((Instruction.STATUS, status.error)) + status.parameters
        return _frame(status.servo, content if status.servo == BROADCAST else stuffed(content))

    def status_length(self, parameters: int) -> int:
        """Return how many bytes an answer with so many bytes of parameters takes before stuffing."""
        return 11 + parameters

    def status_decoder(self) -> Decoder[Status]:
        """Return a decoder of answers; requests, such as an adapter's echo, it skips."""
        return StreamDecoder(STATUS)

    def request_decoder(self) -> Decoder[Request]:
        """Return a decoder of requests; the answers of other servos it skips."""
        return StreamDecoder(REQUEST)

    def read(self, span: Span) -> Request:
        """Return the request that reads a span of one servo."""
        return Request(span.servo, Instruction.READ, _words(span.address, span.length))

    def write(self, write: Write, *, registered: bool = False) -> Request:
        """Return the request that writes to one servo: at once, or, `registered`, when ACTION comes."""
        instruction = Instruction.REG_WRITE if registered else Instruction.WRITE
        return Request(write.servo, instruction, _words(write.address) + write.data)

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> Request:
        """Return the request that writes `data`, all of one length, by servo, to one address of several servos."""
        parts = [_words(address, equal_length(data))]
        parts += [_id(servo) + value for servo, value in data.items()]
        return Request(BROADCAST, Instruction.SYNC_WRITE, b"".join(parts))

    def bulk_write(self, writes: Sequence[Write]) -> Request:
        """Return the request that writes to several servos, to each at an address of its own."""
        each_once([write.servo for write in writes])
        parts = [_id(write.servo) + _words(write.address, len(write.data)) + write.data for write in writes]
        return Request(BROADCAST, Instruction.BULK_WRITE, b"".join(parts))

    def group_read(self, spans: Sequence[Span]) -> Request:
        """Return the sync read of spans that are alike, else the bulk read; each servo answers by itself."""
        if all_alike(spans):
            return self.sync_read(spans)
        return Request(BROADCAST, Instruction.BULK_READ, _bulk(spans))

    def sync_read(self, spans: Sequence[Span]) -> Request:
        """Return the request that reads the same span of several servos; each answers by itself."""
        return Request(BROADCAST, Instruction.SYNC_READ, _sync(spans))

    def fast_sync_read(self, spans: Sequence[Span]) -> Request:
        """Return the request that reads the same span of several servos, which answer in one packet."""
        return Request(BROADCAST, Instruction.FAST_SYNC_READ, _sync(spans))

    def fast_bulk_read(self, spans: Sequence[Span]) -> Request:
        """Return the request that reads a span of each of several servos, which answer in one packet."""
        return Request(BROADCAST, Instruction.FAST_BULK_READ, _bulk(spans))

    def spans(self, request: Request) -> Sequence[Span]:
        """Return what a request reads, in the order of the answers: none where it reads nothing."""
        data = request.parameters
        if request.instruction == Instruction.READ:
            return [Span(request.servo, *_numbers(data, 2))]
        if request.instruction in SYNC_READS:
            address, length = _numbers(data[:4], 2)
            return [Span(servo, address, length) for servo in data[4:]]
        if request.instruction in BULK_READS:
            return [Span(data[at], *_numbers(data[at + 1 : at + 5], 2)) for at in range(0, len(data), 5)]
        return []

    def writes(self, request: Request) -> Sequence[Write]:
        """Return what a request writes (also a registered one): none where it writes nothing."""
        data = request.parameters
        if request.instruction in (Instruction.WRITE, Instruction.REG_WRITE):
            return [Write(request.servo, _numbers(data[:2], 1)[0], data[2:])]
        if request.instruction == Instruction.SYNC_WRITE:
            address, length = _numbers(data[:4], 2)
            groups = (_whole(data[at : at + 1 + length], 1 + length) for at in range(4, len(data), 1 + length))
            return [Write(group[0], address, group[1:]) for group in groups]
        return _bulk_writes(data) if request.instruction == Instruction.BULK_WRITE else []


PROTOCOL2 = Protocol2()


def combined(answers: Sequence[Status]) -> Status:
    """Return the one answer to a fast read that bears those of several servos (what emulators send)."""
    crc, parts = _crc_of_head(sum(4 + len(answer.parameters) for answer in answers)), list[bytes]()
    for answer in answers:
        part = bytes((answer.error, answer.servo)) + answer.parameters
        crc = crc16(part, crc)
        parts.append(part + WORD.pack(crc))
        crc = crc16(parts[-1][-2:], crc)
    whole = b"".join(parts)
    return Status(BROADCAST, whole[0], whole[1:-2])


def split_fast(status: Status, spans: Sequence[Span]) -> list[Status]:
    """Return the answers of the servos within the one answer to a fast read of `spans`.

    Those from the first on that is not where it should be, or whose own CRC is wrong, are left out.
    """
    whole = bytes((status.error,)) + status.parameters
    crc, position, found = _crc_of_head(len(whole) + 2), 0, list[Status]()
    for span in spans:
        end = position + 2 + span.length
        part = whole[position:end]
        crc = crc16(part, crc)
        its_crc = whole[end : end + 2]
        if len(part) != 2 + span.length or part[1] != span.servo or its_crc not in (b"", WORD.pack(crc)):
            break
        found.append(Status(part[1], part[0], part[2:]))
        crc, position = crc16(its_crc, crc), end + 2
    return found


def _crc_of_head(length: int) -> int:
    """Return the CRC of what stands before the servos' answers, which have `length` bytes with their CRCs."""
    return crc16(HEADER + bytes((BROADCAST,)) + WORD.pack(1 + length) + bytes((Instruction.STATUS,)))


def stuffed(content: bytes) -> bytes:
    """Return `content` with one more FD after each FF FF FD."""
    return content.replace(UNSTUFFED, STUFFED)


def unstuffed(content: bytes) -> bytes:
    """Return `content` as it was before stuffing."""
    return content.replace(STUFFED, UNSTUFFED)


def all_alike(spans: Sequence[Span]) -> bool:
    """Return whether the spans are of one address and length."""
    return len({(span.address, span.length) for span in spans}) == 1


def _frame(servo: int, content: bytes) -> bytes:
    length = WORD.pack(len(fits(content, LONGEST - 2)) + 2)
    packet = HEADER + bytes((servo,)) + length + content
    return packet + WORD.pack(crc16(packet))


def _sync(spans: Sequence[Span]) -> bytes:
    each_once([span.servo for span in spans])
    if not all_alike(spans):
        raise SpecError("a sync read takes the same span of each servo: use a bulk read.")
    return _words(spans[0].address, spans[0].length) + b"".join(_id(span.servo) for span in spans)


def _bulk(spans: Sequence[Span]) -> bytes:
    each_once([span.servo for span in spans])
    return b"".join(_id(span.servo) + _words(span.address, span.length) for span in spans)


def _bulk_writes(data: bytes) -> list[Write]:
    writes, position = list[Write](), 0
    while position < len(data):
        address, length = _numbers(data[position + 1 : position + 5], 2)
        value = _whole(data[position + 5 : position + 5 + length], length)
        writes.append(Write(data[position], address, value))
        position += 5 + length
    return writes


def _id(servo: int) -> bytes:
    check(servo, 0, HIGHEST_ID)
    return bytes((servo,))


def _words(*values: int) -> bytes:
    if not all(0 <= value <= 0xFFFF for value in values):
        raise SpecError(f"protocol 2.0 has addresses and lengths from 0 to 65535, not {list(values)}.")
    return b"".join(map(WORD.pack, values))


def _numbers(data: bytes, count: int) -> tuple[int, ...]:
    return tuple(number for (number,) in WORD.iter_unpack(_whole(data, 2 * count)))


def _whole(data: bytes, size: int) -> bytes:
    if len(data) != size:
        raise SpecError(f"the parameters end after {len(data)} of {size} bytes.")
    return data
