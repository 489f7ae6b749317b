"""When the world began that all devices emulated for this process are part of."""

from __future__ import annotations

from functools import cache

from rtagent.clock import RealClock


@cache
def began_on_the_wire() -> int:
    """Return the monotonic time (ns), which other processes share, of the first that asked."""
    return RealClock.now()
