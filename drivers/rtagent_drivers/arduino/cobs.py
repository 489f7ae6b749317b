"""Consistent Overhead Byte Stuffing (Cheshire and Baker 1999): data without zeros, which a zero can end."""

from __future__ import annotations

LONGEST_RUN = 254


def stuffed(data: bytes) -> bytes:
    """Return `data` without zeros; the zero that ends a frame is not added."""
    runs = bytearray()
    for number, run in enumerate(pieces := data.split(b"\0")):
        last = number == len(pieces) - 1
        while len(run) >= LONGEST_RUN:
            runs += b"\xff" + run[:LONGEST_RUN]
            run = run[LONGEST_RUN:]  # what is left of it
            if not run and last:
                return bytes(runs)
        runs.append(len(run) + 1)
        runs += run
    return bytes(runs)


def unstuffed(data: bytes) -> bytes | None:
    """Return what was stuffed, or None where that cannot be."""
    out, at = bytearray(), 0
    while at < len(data):
        mark = data[at]
        run = data[at + 1 : at + mark]
        if not mark or len(run) != mark - 1:
            return None
        out += run
        at += mark
        if mark <= LONGEST_RUN and at < len(data):
            out.append(0)
    return bytes(out)
