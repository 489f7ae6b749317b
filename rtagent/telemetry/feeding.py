"""From the buffer of the loop to the ring of the sender: packed by a thread that is never long in anybody's way."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

from rtagent.clock import RealClock
from rtagent.experience import Transition
from rtagent.telemetry.collect import Collector, Cycle, Lost
from rtagent.telemetry.lull import Lull
from rtagent.telemetry.packing import pack
from rtagent.telemetry.ring import Ring
from rtagent.units import second

PAUSE = 0.01
"""How long (s) it rests."""
MANY = 100
"""Where as many cycles wait, it waits for no lull."""


class Feeder:
    """Packs what a collector has into a ring, the oldest first; where that is full, it waits in the buffer.

    Once a second it has the collector count.
    """

    def __init__(self, collector: Collector, ring: Ring, lull: Lull) -> None:
        self._buffer, self._count = collector.buffer, collector.count
        self._ring, self._lull = ring, lull
        self._next_count = 0
        self._packed: bytes | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, name="telemetry", daemon=True)

    def start(self) -> None:
        """Begin, in a thread."""
        self._thread.start()

    def close(self, timeout: float) -> None:
        """Pack what is left, within `timeout` (s), and end."""
        self._ending.set()
        self._thread.join(timeout)

    def feed(self) -> bool:
        """Pack one cycle; say whether there was one, and room for it."""
        if self._packed is None:
            if not self._buffer:
                return False
            self._packed = self._pack(self._buffer.popleft())
        if not self._ring.write(self._packed):
            return False
        self._packed = None
        return True

    def _pack(self, cycle: Cycle) -> bytes:
        """Return a cycle as bytes; of one that could never find room, what is lost."""
        self._lull.heard(cycle[0])
        data = packed(cycle)
        if self._ring.could_hold(data):
            return data
        calls, newest, before = cycle
        lost = Lost(before)
        lost.add(calls, newest)
        return packed(((), None, lost.told()))

    def _work(self) -> None:
        pause = threading.Event()
        while not (self._ending.is_set() and not self._buffer and self._packed is None):
            while self._feed_in_lull():
                give_way()
            pause.wait(PAUSE)
            self._count_in_time()

    def _count_in_time(self) -> None:
        if RealClock.now() >= self._next_count and not self._ending.is_set():
            self._next_count = RealClock.now() + second
            self._count()

    def _feed_in_lull(self) -> bool:
        """Pack one cycle once the loop rests; say whether there was one, and room for it."""
        if self._buffer and len(self._buffer) < MANY:
            self._ending.wait(self._lull.until(RealClock.now()) / second)
        began = RealClock.now()
        fed = self.feed()
        self._lull.took(RealClock.now() - began)
        return fed


def packed(cycle: Cycle) -> bytes:
    """Return a cycle as bytes."""
    calls, newest, lost = cycle
    plain = [(name, _step(*args)) if name == "learned" else (name, args) for name, args in calls]
    return pack((lost, plain, newest))


def _step(transition: Transition, delta: float, time: int) -> tuple[Any, ...]:
    """Return what is told of a transition: all but its features, which follow from its states."""
    t = transition
    return (
        t.action, t.next_action, t.probability, t.reward, t.elapsed, t.terminated, t.truncated,
        t.state, t.next_state, t.complete_at, delta, time,
    )  # fmt: skip


give_way: Callable[[], None] = getattr(os, "sched_yield", lambda: None)
"""Lets the loop have the GIL, if it wants it."""
