"""The frames of our own sketches (firmware/libraries/rtagent/src/frames.h): bytes in, messages out, and back.

A frame is a type, a body and a CRC-16 (CCITT, from 0xFFFF), stuffed by COBS and ended by a zero. Numbers are little
endian. No I/O.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable, Mapping, Sequence
from struct import Struct, error, pack

from rtagent.units import ms, us
from rtagent_drivers.arduino.cobs import stuffed, unstuffed
from rtagent_drivers.arduino.messages import Hello, Message, Scan, ServoState

VERSION = 1
LONGEST = 512
"""Bytes without a zero that are no frame any more."""

ANALOG = 0x80
"""Marks the number of an analog pin."""

UNCHANGED = 0xFFFF
"""In place of a pulse: that servo goes on as it does."""

SCAN = Struct("<HI")
HELLO = Struct("<BBIHHHB")
STATE = Struct("<BH")


def frame(kind: bytes, body: bytes = b"") -> bytes:
    """Return a frame of a type (one byte) with a body, ready to be sent."""
    data = kind + body
    return stuffed(data + crc_hqx(data, 0xFFFF).to_bytes(2, "little")) + b"\0"


# What the host says

ASK, ARM, MAKE_SAFE = frame(b"h"), frame(b"a"), frame(b"s")


def configure(period: int, heartbeat: int, *, holds: bool) -> bytes:
    """Return the frame that sets the period of scans, the time without a word (ns) that is borne, and what then."""
    return frame(b"c", pack("<IHB", round(period / us), round(heartbeat / ms), holds))


def pulses(widths: Sequence[int | None]) -> bytes:
    """Return the frame that gives each servo pulses of so many µs (0: none; None: as before)."""
    return frame(b"v", pack(f"<{len(widths)}H", *(UNCHANGED if width is None else width for width in widths)))


# What a board says


def scan(readings: Sequence[int], number: int, micros: int) -> bytes:
    """Return the frame of a scan."""
    return frame(b"S", SCAN.pack(number, micros) + pack(f"<{len(readings)}H", *readings))


def hello(said: Hello) -> bytes:
    """Return the frame in which a board says what it is."""
    head = HELLO.pack(
        said.version,
        said.started,
        said.period // us,
        said.scan // us,
        said.lag // us,
        said.heartbeat // ms,
        said.holds,
    )
    channels, servos = [_pin_number(pin) for pin in said.channels], said.servos
    return frame(b"H", head + bytes([len(channels), *channels, len(servos), *servos]))


def servo_state(state: ServoState) -> bytes:
    """Return the frame in which a board says what its servos do."""
    return frame(b"V", STATE.pack(state.safety, state.bad) + pack(f"<{len(state.pulses)}H", *state.pulses))


def contents(stuffed_frame: bytes) -> bytes | None:
    """Return type and body of a frame (its zero left out), or None where it is damaged."""
    data = unstuffed(stuffed_frame)
    if data is None or len(data) < 3 or crc_hqx(data[:-2], 0xFFFF) != int.from_bytes(data[-2:], "little"):
        return None
    return data[:-2]


class FrameDecoder:
    """Messages of the bytes of a board; those before the first zero may be the end of a frame, and are borne."""

    def __init__(self) -> None:
        self.bad = 0
        self._begun = False
        self._rest = b""

    def feed(self, data: bytes, /) -> Sequence[Message]:
        """Take bytes; return the messages that are complete with them."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        if len(self._rest) > LONGEST:
            self.bad += 1
            self._rest, self._begun = b"", False  # what follows is in the middle of something, too
        messages: list[Message] = []
        for piece in pieces:
            message = _message(piece) if piece else None
            if message is not None:
                messages.append(message)
            elif piece and self._begun:
                self.bad += 1
            self._begun = True
        return messages


def _message(piece: bytes) -> Message | None:
    data = contents(piece)
    if data is None:
        return None
    reader = READERS.get(data[:1])
    try:
        return None if reader is None else reader(data[1:])
    except (error, IndexError):
        return None


def _scan(body: bytes) -> Scan:
    number, micros = SCAN.unpack_from(body)
    return Scan(_words(body[SCAN.size :]), number, micros)


def _hello(body: bytes) -> Hello:
    if body[0] != VERSION:
        return Hello(body[0])
    version, started, period, takes, lag, heartbeat, holds = HELLO.unpack_from(body)
    count = body[HELLO.size]
    channels, servos = body[HELLO.size + 1 :][:count], body[HELLO.size + 1 + count :]
    if len(channels) != count or len(servos) != servos[0] + 1:
        raise IndexError("a hello that is shorter or longer than it says")
    pins = tuple(_pin_name(number) for number in channels)
    times = period * us, takes * us, lag * us, heartbeat * ms
    return Hello(version, bool(started), *times, bool(holds), pins, tuple(servos[1:]))


def _state(body: bytes) -> ServoState:
    safety, bad = STATE.unpack_from(body)
    return ServoState(safety, bad, _words(body[STATE.size :]))


READERS: Mapping[bytes, Callable[[bytes], Message]] = {b"S": _scan, b"H": _hello, b"V": _state}


def _words(data: bytes) -> tuple[int, ...]:
    return tuple(Struct(f"<{len(data) // 2}H").unpack(data))


def _pin_name(number: int) -> str:
    return f"A{number & ~ANALOG}" if number & ANALOG else str(number)


def _pin_number(name: str) -> int:
    return ANALOG | int(name[1:]) if name.startswith("A") else int(name)
