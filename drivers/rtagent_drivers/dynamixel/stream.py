"""Finding packets in a stream of bytes, whatever stands between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

Packet = TypeVar("Packet")
Packet_co = TypeVar("Packet_co", covariant=True)


class Framing(Protocol[Packet_co]):
    """How packets of one kind begin and end."""

    header: bytes
    shortest: int
    """As many bytes must be there before a packet can be measured."""
    longest: int

    def end(self, buffer: bytes, start: int) -> int:
        """Return where the packet ends whose header is at `start`; `start` itself where it can be none."""

    def cut_short(self, buffer: bytes, start: int) -> bool:
        """Return whether the rest of an incomplete packet can no longer come."""

    def parse(self, frame: bytes) -> Packet_co | None:
        """Return the packet, or None where its checksum is wrong."""


class StreamDecoder(Generic[Packet]):
    """The decoder of one framing. What looked like a packet and was none is searched again for others."""

    def __init__(self, framing: Framing[Packet]) -> None:
        self._framing = framing
        self._rest = b""
        self.longest = framing.longest
        self.damaged = 0
        self.skipped = 0

    def feed(self, data: bytes) -> Sequence[Packet]:
        """Take further bytes; return the packets that they complete, in order."""
        buffer = self._rest + data if self._rest else bytes(data)
        found: list[Packet] = []
        self._rest = buffer[self._scan(buffer, found) :]
        return found

    def reset(self) -> Sequence[Packet]:
        """Give up waiting for the rest of a packet; return those after its start."""
        found: list[Packet] = []
        while rest := self._rest:
            following = rest.find(self._framing.header, 1)
            start = len(rest) if following < 0 else following
            self.damaged += len(rest) >= self._framing.shortest
            self.skipped += start
            self._rest = b""
            found.extend(self.feed(rest[start:]))
        return found

    def _scan(self, buffer: bytes, found: list[Packet]) -> int:
        """Add the packets in `buffer` to `found`; return from where on it may hold another."""
        framing, position = self._framing, 0
        header, size = framing.header, len(buffer)
        while (start := buffer.find(header, position)) >= 0:
            self.skipped += start - position
            if size - start < framing.shortest:
                return start
            end = framing.end(buffer, start)
            if end - start > self.longest:
                end = start
            if end > size and not framing.cut_short(buffer, start):
                return start
            packet = framing.parse(buffer[start:end]) if start < end <= size else None
            if packet is not None:
                found.append(packet)
                position = end
            else:
                self.damaged += end > start
                self.skipped += 1
                position = start + 1
        return position if position == size else self._tail(buffer, position)

    def _tail(self, buffer: bytes, position: int) -> int:
        """Return where the beginning of a header stands at the end of `buffer`, or its end."""
        header = self._framing.header
        start = next(
            (len(buffer) - n for n in range(len(header) - 1, 0, -1) if buffer.endswith(header[:n], position)),
            len(buffer),
        )
        self.skipped += start - position
        return start
