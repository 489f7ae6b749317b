"""The ring between the loop and the sender: nothing comes out that did not go in, and in no other order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.telemetry.ring import DATA, LENGTH, Ring

SIZE = 100


@contextmanager
def rings() -> Iterator[tuple[Ring, Ring]]:
    """Give both ends of a ring, as two processes have them."""
    fd = os.memfd_create("test")
    os.ftruncate(fd, DATA + SIZE)
    ends = Ring(fd, SIZE), Ring(fd, SIZE)
    yield ends
    for end in ends:
        end.close()
    os.close(fd)


@given(st.lists(st.one_of(st.none(), st.integers(0, 120)), max_size=80))
@settings(max_examples=200, deadline=None)
def test_what_is_read_is_what_was_written(steps: list[int | None]) -> None:
    """A number writes a message of that length, None reads one."""
    model: deque[bytes] = deque()
    with rings() as (writer, reader):
        for number, step in enumerate(steps):
            if step is None:
                assert reader.read() == (model.popleft() if model else None)
                continue
            message = bytes([number % 256]) * step
            if writer.write(message):
                model.append(message)
            else:
                assert writer.filled + 2 * (len(message) + 2 * LENGTH) > SIZE, "there was room for it"
        assert [reader.read() for _ in model] == list(model)
        assert reader.read() is None
        assert writer.filled == 0


@given(st.integers(0, 60), st.integers(0, 60))
@settings(deadline=None)
def test_what_it_could_hold_finds_room_wherever_it_begins(before: int, length: int) -> None:
    with rings() as (writer, reader):
        writer.write(bytes(before))
        reader.read()
        if writer.could_hold(bytes(length)):
            assert writer.write(bytes(length))
            assert reader.read() == bytes(length)


def test_a_full_ring_takes_nothing_and_loses_nothing() -> None:
    with rings() as (writer, reader):
        taken = sum(writer.write(bytes([number]) * 10) for number in range(20))
        assert 0 < taken < 20
        assert [reader.read() for _ in range(taken)] == [bytes([number]) * 10 for number in range(taken)]
