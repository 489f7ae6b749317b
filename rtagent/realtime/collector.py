"""Garbage collected in calm moments, in place of whenever so many objects have been made."""

from __future__ import annotations

import gc

from rtagent.clock import RealClock

AT_THE_LATEST = 100_000
"""So many new objects, and Python collects by itself: a run that is never calm must not fill the memory."""

REST = 1000
"""A full collection is followed by so many times its own length without another."""


class Collector:
    """Decides in calm moments what is to be collected; from its making to `close` nobody else does.

    What is there when it is made is taken to stay, and never looked through again (`gc.freeze`).
    """

    def __init__(self) -> None:
        self._before = gc.get_threshold()
        self.collections = [0, 0, 0]
        gc.set_threshold(max(AT_THE_LATEST, self._before[0]), *self._before[1:])
        self.settle()

    def settle(self) -> None:
        """Collect everything and take the rest to stay: before a run, when all its parts have been made."""
        self._collect_all()
        gc.freeze()

    def calm(self) -> None:
        """Collect what is due: the young, sometimes the middle-aged, all of them rarely; mostly nothing."""
        young, middle, old = gc.get_count()
        if young < self._before[0]:
            return
        if old >= self._before[2] and RealClock.now() >= self._full_again:
            self._collect_all()
        else:
            self._collect(1 if middle >= self._before[1] else 0)

    def close(self) -> None:
        """Leave it all to Python again."""
        gc.set_threshold(*self._before)
        gc.unfreeze()

    def _collect_all(self) -> None:
        began = RealClock.now()
        self._collect(2)
        ended = RealClock.now()
        self._full_again = ended + REST * (ended - began)

    def _collect(self, generation: int) -> None:
        gc.collect(generation)
        self.collections[generation] += 1
