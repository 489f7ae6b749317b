"""The formats of older sketches: lines of comma-separated numbers, and frames that nothing protects. No I/O.

Neither has a check: a line whose middle was lost, together with the end of another, can look whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct

from rtagent_drivers.arduino.messages import LARGEST_READING, Message, Scan

LONGEST_LINE = 256
HEADER = b"\x00\x2e\x00\x2e"
READINGS = Struct(">6H")
SIZE = len(HEADER) + READINGS.size


class LineDecoder:
    """Scans from lines of `count` numbers, separated by commas; what comes before the first line end is cut."""

    def __init__(self, count: int, switches: frozenset[int] = frozenset()) -> None:
        self.bad = 0
        self._most = tuple(1 if field in switches else LARGEST_READING for field in range(count))
        self._begun = False
        self._rest = b""

    def feed(self, data: bytes, /) -> Sequence[Message]:
        """Take bytes; return the scans that are complete with them."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            self.bad += self._begun
            self._rest, self._begun = b"", False
        scans: list[Message] = []
        for line in lines:
            scan = self._scan(line) if self._begun else None
            if scan is not None:
                scans.append(scan)
            else:
                self.bad += self._begun
            self._begun = True
        return scans

    def _scan(self, line: bytes) -> Scan | None:
        fields = [field.strip() for field in line.split(b",")]
        if len(fields) != len(self._most) or not all(map(_is_number, fields)):
            return None
        readings = tuple(map(int, fields))
        if any(reading > most for reading, most in zip(readings, self._most, strict=True)):
            return None
        return Scan(readings)


def _is_number(field: bytes) -> bool:
    return 1 <= len(field) <= 4 and field.isdigit()


def line(readings: Sequence[int], separator: str) -> bytes:
    """Return the line of a scan."""
    return separator.join(map(str, readings)).encode() + b"\r\n"


def positions(degrees: Sequence[int]) -> bytes:
    """Return what moves the six servos of a legacy hand: angles of 0 to 180 degrees."""
    return ",".join(map(str, degrees)).encode() + b"."


class WordDecoder:
    """Scans from frames of 16 bytes: a header, and six numbers of two bytes, big endian.

    The header may stand among the numbers, too: out of step, a frame counts only if another header follows it.
    """

    def __init__(self) -> None:
        self.bad = 0
        self._begun = self._in_step = False
        self._rest = b""

    def feed(self, data: bytes, /) -> Sequence[Message]:
        """Take bytes; return the scans that are complete with them."""
        data, at = self._rest + data, 0
        scans: list[Message] = []
        while len(data) - at >= SIZE + (0 if self._in_step else len(HEADER)):
            readings = self._readings(data, at)
            if readings is not None:
                scans.append(Scan(readings))
                at += SIZE
                self._begun = self._in_step = True
                continue
            self.bad += self._begun and self._in_step
            self._in_step = False
            found = data.find(HEADER, at + 1)
            at = found if found >= 0 else len(data) - len(HEADER) + 1
        self._rest = data[at:]
        return scans

    def _readings(self, data: bytes, at: int) -> tuple[int, ...] | None:
        if not data.startswith(HEADER, at) or not (self._in_step or data.startswith(HEADER, at + SIZE)):
            return None
        readings = READINGS.unpack_from(data, at + len(HEADER))
        return readings if max(readings) <= LARGEST_READING else None


def words(readings: Sequence[int]) -> bytes:
    """Return the frame of 16 bytes of a scan."""
    return HEADER + READINGS.pack(*readings)
