"""Time slices of single threads, which Linux 6.12 has: who asks for a short one is let in soon, but gets no more.

Nobody needs to allow it, and others keep their share of the processors (`sched_setattr(2)`, `sched_runtime` of
`SCHED_OTHER`; the scheduler is EEVDF, which runs whose slice ends first).
"""

from __future__ import annotations

import ctypes
import os
import platform
import sys
from collections.abc import Callable

SHORTEST = 100_000
"""The shortest slice (ns) that Linux gives; where it is left to it, it gives one of a millisecond or several."""
ORDINARY = (getattr(os, "SCHED_OTHER", 0), getattr(os, "SCHED_BATCH", 3))
"""The policies whose threads have slices."""
CALLS = {"x86_64": (314, 315), "aarch64": (274, 275), "riscv64": (274, 275), "armv7l": (380, 381)}
"""The numbers of `sched_setattr` and `sched_getattr` by architecture: the C library may have no names for them."""


class Attributes(ctypes.Structure):
    """`struct sched_attr`, in its first version."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def time_slice() -> int:
    """Return the time slice (ns) of this thread; 0 where the system has none for single threads."""
    return int(_attributes().runtime)


def short_slice() -> Callable[[], None] | None:
    """Give this thread, and those that it starts, the shortest slice.

    Return what gives it back, or None where the system has no slices for single threads, or this thread has no
    ordinary scheduling.
    """
    before = time_slice()
    if before:
        _set(SHORTEST)
    return (lambda: _set(before)) if before and time_slice() == SHORTEST else None


def usual_slice() -> None:
    """Leave the slice of this thread to the system: for a process that a thread with a short one has started."""
    if time_slice():
        _set(0)


def _set(nanoseconds: int) -> None:
    attributes = _attributes()
    attributes.runtime = nanoseconds
    _call(0, ctypes.byref(attributes), 0)


def _attributes() -> Attributes:
    """Return those of this thread; without a slice where there is none to be set."""
    attributes = Attributes()
    size = ctypes.sizeof(attributes)
    if _call(1, ctypes.byref(attributes), size, 0) or attributes.policy not in ORDINARY:
        return Attributes()
    return attributes


def _call(which: int, *args: object) -> int:
    numbers = CALLS.get(platform.machine())
    if sys.platform != "linux" or numbers is None:
        return -1
    return int(ctypes.CDLL(None).syscall(numbers[which], 0, *args))
