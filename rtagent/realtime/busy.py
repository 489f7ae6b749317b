"""A watch over a loop that has a real-time priority: one that is always busy must not keep it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rtagent.clock import RealClock
from rtagent.units import ms, second

INTERVAL = 400 * ms
LOOKS = 2
"""Found busy so often in a row, before the second is over in which the kernel lets it run for 950 ms."""
ALWAYS = 0.9
"""A loop that computes for this share of the time is taken for always busy."""


class BusyWatch:
    """Looks now and then how long its thread has computed, and calls `found` with the share of the time."""

    def __init__(self, found: Callable[[float], None]) -> None:
        self._found = found
        self._busy_looks = 0

    def start(self) -> None:
        """Begin, in the running event loop; it ends with the loop, or when it has found something."""
        self._loop = asyncio.get_running_loop()
        self._since()

    def _since(self) -> None:
        self._then, self._computed = RealClock.now(), RealClock.computed()
        self._loop.call_later(INTERVAL / second, self._look)

    def _look(self) -> None:
        share = (RealClock.computed() - self._computed) / (RealClock.now() - self._then)
        self._busy_looks = self._busy_looks + 1 if share >= ALWAYS else 0
        if self._busy_looks == LOOKS:
            self._found(share)
        else:
            self._since()
