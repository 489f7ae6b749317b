"""A bounded buffer between two processes: one writes messages into shared memory, the other reads them.

Writing neither waits nor gives the GIL up. What finds it full is not written.
"""

from __future__ import annotations

import mmap
import threading

HEAD, TAIL, DATA = 0, 1, 64
"""Places of the two counts, in words of 8 bytes, and where messages begin, in bytes."""
LENGTH = 4
POPULATED = getattr(mmap, "MAP_POPULATE", 0)
"""All of it is there from the beginning: a page that comes when it is first written to takes microseconds."""
WRAP = (0xFFFFFFFF).to_bytes(LENGTH, "little")
"""Stands where the next message did not fit before the end, and begins at the start."""


class Ring:
    """A ring over the shared memory of a file; `size` is what it can hold, in bytes.

    Both counts only grow. Each is written by one side alone, after what it stands for.
    """

    def __init__(self, fd: int, size: int) -> None:
        self._memory = memoryview(mmap.mmap(fd, DATA + size, flags=mmap.MAP_SHARED | POPULATED))
        self._counts, self._data = self._memory[:DATA].cast("Q"), self._memory[DATA:]
        self._size = size
        self._fence = threading.Lock()

    @property
    def filled(self) -> int:
        """How many bytes wait to be read."""
        return self._counts[HEAD] - self._counts[TAIL]

    def could_hold(self, message: bytes) -> bool:
        """Say whether a message fits into it, once it is empty, wherever it begins."""
        return 2 * (len(message) + 2 * LENGTH) <= self._size

    def write(self, message: bytes) -> bool:
        """Write a message; say whether it found room."""
        head, length = self._counts[HEAD], len(message)
        place = head % self._size
        end = place + LENGTH + length
        if end + LENGTH > self._size:  # there is always room left for the mark
            return self._wrap(head, place, message)
        if head + LENGTH + length - self._counts[TAIL] > self._size:
            return False
        self._data[place : place + LENGTH] = length.to_bytes(LENGTH, "little")
        self._data[place + LENGTH : end] = message
        self._publish(HEAD, head + LENGTH + length)
        return True

    def _wrap(self, head: int, place: int, message: bytes) -> bool:
        """Write a message at the start, unless it does not fit there either."""
        new = head - place + self._size + LENGTH + len(message)
        if 2 * LENGTH + len(message) > self._size or new - self._counts[TAIL] > self._size:
            return False
        self._data[place : place + LENGTH] = WRAP
        self._data[:LENGTH] = len(message).to_bytes(LENGTH, "little")
        self._data[LENGTH : LENGTH + len(message)] = message
        self._publish(HEAD, new)
        return True

    def read(self) -> bytes | None:
        """Return the oldest message, or None where there is none."""
        tail = self._counts[TAIL]
        if tail == self._counts[HEAD]:
            return None
        self._order()
        place = tail % self._size
        mark = bytes(self._data[place : place + LENGTH])
        if mark == WRAP:
            tail, place = tail - place + self._size, 0
            mark = bytes(self._data[:LENGTH])
        length = int.from_bytes(mark, "little")
        message = bytes(self._data[place + LENGTH : place + LENGTH + length])
        self._publish(TAIL, tail + LENGTH + length)
        return message

    def _publish(self, count: int, value: int) -> None:
        self._order()
        self._counts[count] = value

    def _order(self) -> None:
        """Keep what was read and written before it before what comes after, also where processors reorder it."""
        self._fence.acquire()
        self._fence.release()

    def close(self) -> None:
        """Let go of the memory."""
        self._counts.release()
        self._data.release()
        self._memory.release()
