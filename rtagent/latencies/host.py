"""What the host took while something was measured: time on the processor that went to others.

The kernel tells, in /proc/stat (`steal`: the hypervisor ran somebody else) and in /proc/thread-self/schedstat (its
second figure: this thread was ready, and another ran).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rtagent import clock
from rtagent.errors import SpecError
from rtagent.units import second

STAT, SCHEDSTAT = Path("/proc/stat"), Path("/proc/thread-self/schedstat")
STEAL = 8
"""The column of /proc/stat (proc(5)), counted from the name of the processor."""


@dataclass
class Disturbance:
    """How long (ns) something lasted, how long of it the host had the processor, and others of this machine had."""

    lasted: int = 0
    stolen: int = 0
    waited: int = 0

    @property
    def share(self) -> float:
        """Which part of the time was lost to others."""
        return (self.stolen + self.waited) / self.lasted if self.lasted else 0.0


@contextlib.contextmanager
def watched(processor: int | None, schedstat: Path | None = None) -> Iterator[Disturbance]:
    """Measure what a thread, bound to `processor`, loses to others: nothing where the kernel does not tell.

    The thread is this one, or that of a `schedstat` of its own.
    """
    found, now = Disturbance(), clock.RealClock().now
    began, stolen, waited = now(), _stolen(processor), _waited(schedstat)
    try:
        yield found
    finally:
        found.lasted = now() - began
        found.stolen, found.waited = _stolen(processor) - stolen, _waited(schedstat) - waited


@contextlib.contextmanager
def bound_to(processor: int | None) -> Iterator[int | None]:
    """Keep this thread on one processor (None: the last that it may use); raises `SpecError` where it may not."""
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    before = os.sched_getaffinity(0)
    processor = max(before) if processor is None else processor
    if processor not in before:
        raise SpecError(f"processor {processor} is not for us: use one of {', '.join(map(str, sorted(before)))}.")
    os.sched_setaffinity(0, {processor})
    try:
        yield processor
    finally:
        os.sched_setaffinity(0, before)


def _stolen(processor: int | None) -> int:
    """Return the time (ns) that a hypervisor has taken from a processor, or from all."""
    name = "cpu" if processor is None else f"cpu{processor}"
    try:
        rows = (line.split() for line in STAT.read_text().splitlines())
        ticks = next((int(row[STEAL]) for row in rows if row[0] == name and len(row) > STEAL), 0)
    except OSError:
        return 0
    return ticks * second // os.sysconf("SC_CLK_TCK")


def _waited(schedstat: Path | None) -> int:
    """Return for how long (ns) a thread was ready and did not run."""
    try:
        return int((schedstat or SCHEDSTAT).read_text().split()[1])
    except (OSError, IndexError):
        return 0
