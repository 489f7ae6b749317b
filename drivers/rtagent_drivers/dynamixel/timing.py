"""How long transactions take on the wire."""

from __future__ import annotations

from collections.abc import Iterable

BITS_PER_BYTE = 10
"""A start bit, eight of data, a stop bit."""


def wire(length: int, baud: int) -> int:
    """Return how long (ns) so many bytes take at `baud` (bit/s)."""
    return length * BITS_PER_BYTE * 1_000_000_000 // baud


def transaction(request_length: int, reply_lengths: Iterable[int], baud: int, return_delay: int) -> int:
    """Return how long (ns) a request and its replies take.

    Lengths are in bytes of whole packets, `baud` in bit/s; and each reply waits for `return_delay` (ns).
    """
    replies = list(reply_lengths)
    return wire(request_length + sum(replies), baud) + len(replies) * return_delay
