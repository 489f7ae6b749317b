"""The wire of an emulated bus: when bytes are on it, and what becomes of them there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from random import Random

from rtagent.units import ms
from rtagent_drivers.dynamixel.emulated.faults import Fault, Kind, Plan
from rtagent_drivers.dynamixel.timing import wire

BABBLE = 1 * ms
"""Garbage that fills the line comes in pieces so long."""


@dataclass
class Packet:
    """Bytes of an answer that are on the wire from `begin` to `end` (ns)."""

    begin: int
    end: int
    data: bytes


class Line:
    """A half-duplex wire: what begins while something else is on it spoils both. Times in ns, the baud in bit/s.

    Without `timing` bytes take no time, and nothing collides.
    """

    def __init__(self, faults: Plan, *, timing: bool, seed: int = 0) -> None:
        self.timing = timing
        self._faults, self._random = faults, Random(seed)  # noqa: S311  # garbage needs no secrecy
        self._answers: list[Packet] = []
        self._free = 0
        self._babbled_until = 0

    def carry(self, now: int, data: bytes, baud: int) -> tuple[int, bytes]:
        """Take a host's bytes; return when the last of them is over, and what of them can be heard."""
        begin = max(now, self._free)
        end = begin + self.duration(data, baud)
        self._free = end
        met = [answer for answer in self._answers if answer.begin < end and begin < answer.end]
        for answer in met:
            answer.data = self._garbage(len(answer.data))
        spoilt = met or self._faults.of("babble", 0)
        return end, self._garbage(len(data)) if spoilt else data

    def answer(self, after: int, delay: int, servo: int, data: bytes, baud: int) -> int:
        """Put an answer on the wire, `delay` after the time `after`; return when it is over."""
        late = self._befalls("late", servo)
        begin = after + (delay if self.timing else 0) + (late.delay if late else 0)
        if self._befalls("corrupt", servo):
            data = data[:-1] + bytes((data[-1] ^ 0x55,))
        if self._befalls("truncated", servo):
            data = data[: len(data) // 2]
        if self._befalls("noise", servo):
            data = self._garbage(self._random.randint(1, 16)) + data
        if self._faults.of("babble", 0):
            data = self._garbage(len(data))
        end = begin + self.duration(data, baud)
        self._answers.append(Packet(begin, end, data))
        return end

    def collide(self) -> None:
        """Spoil all answers that are under way: several servos speak at once."""
        for answer in self._answers:
            answer.data = self._garbage(len(answer.data))

    def is_silent(self, servo: int) -> bool:
        """Return whether an answer of this servo fails to come."""
        return self._befalls("silent", servo) is not None

    def due(self) -> int | None:
        """Return when (ns) the next bytes reach the host."""
        times = [answer.end for answer in self._answers]
        if self._faults.of("babble", 0):
            times.append(self._babbled_until + BABBLE)
        return min(times, default=None)

    def deliver(self, now: int, baud: int) -> bytes:
        """Return the bytes that reach the host until `now`."""
        arrived = [answer for answer in self._answers if answer.end <= now]
        self._answers = [answer for answer in self._answers if answer.end > now]
        return _joined(arrived) + self._babble(now, baud)

    def duration(self, data: bytes, baud: int) -> int:
        """Return how long (ns) bytes take."""
        return wire(len(data), baud) if self.timing else 0

    def _babble(self, now: int, baud: int) -> bytes:
        if not self._faults.of("babble", 0):
            return b""
        length = min(now - self._babbled_until, 10 * BABBLE) * baud // 10_000_000_000
        self._babbled_until = now
        return self._garbage(max(0, length))

    def _befalls(self, kind: Kind, servo: int) -> Fault | None:
        fault = self._faults.of(kind, servo)
        return fault if fault and self._random.random() < fault.probability else None

    def _garbage(self, length: int) -> bytes:
        return self._random.randbytes(length)


def _joined(packets: Iterable[Packet]) -> bytes:
    return b"".join(packet.data for packet in sorted(packets, key=lambda packet: packet.end))
