"""What a thread can ask of Linux and of Python: each function asks, and returns what gives it back.

Each raises `RefusedError`, a sentence with its cure.
"""

from __future__ import annotations

import asyncio
import ctypes
import getpass
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rtagent.errors import RtagentError

Undo = Callable[[], None]

CONTAINER_MARKS = (Path("/.dockerenv"), Path("/run/.containerenv"))
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4
CAP_IPC_LOCK = 14


class RefusedError(RtagentError):
    """The machine refuses; the message says what would change that."""


def fifo(priority: int) -> Undo:
    """Schedule this thread by SCHED_FIFO at `priority`, 1 to 99; threads and processes that it starts are not."""
    if not hasattr(os, "sched_setscheduler"):
        raise RefusedError(
            f"the scheduling priority {priority} was refused: this system has no SCHED_FIFO; use Linux."
        )
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError:
        cure = permission("sys_nice", "rtprio 95")
        raise RefusedError(f"the scheduling priority {priority} was refused: {cure}") from None
    return lambda: _reschedule(before, parameters)


def _reschedule(policy: int, parameters: os.sched_param) -> None:
    try:
        os.sched_setscheduler(0, policy, parameters)
    except PermissionError:  # only the privileged may take back that children are ordinary
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)


def bind(processors: Sequence[int]) -> Undo:
    """Bind this thread, and those that it starts, to `processors`."""
    refuse_absent(processors)
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, processors)
    return lambda: os.sched_setaffinity(0, before)


def refuse_absent(processors: Sequence[int]) -> None:
    """Refuse processors that are not there, or not for us."""
    if not hasattr(os, "sched_setaffinity"):
        raise RefusedError("binding to processors was refused: this system has no way to; use Linux.")
    there = available_processors()
    absent = sorted(set(processors) - there)
    if absent:
        raise RefusedError(
            f"processor {', '.join(map(str, absent))} is not there for this program: "
            f"name some of {', '.join(map(str, sorted(there)))}."
        )


def available_processors() -> set[int]:
    """Return all processors that this thread may be bound to, whatever it is bound to now."""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, range(os.sysconf("SC_NPROCESSORS_CONF")))  # the kernel leaves out what may not be
        return os.sched_getaffinity(0)
    except OSError:
        return before
    finally:
        os.sched_setaffinity(0, before)


def lock_memory() -> Undo:
    """Keep every page in memory once it has been touched.

    RefusedError under a limit, for under one a later allocation would fail instead.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    every_touched = LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT
    if not may_lock_memory() or libc.mlockall(every_touched):
        raise RefusedError(f"locking memory was refused: {permission('ipc_lock', 'memlock unlimited')}")
    return lambda: libc.munlockall()


def may_lock_memory() -> bool:
    """Return whether this process may lock as much memory as it likes."""
    import resource

    limit = getattr(resource, "RLIMIT_MEMLOCK", None)
    unlimited = limit is not None and resource.getrlimit(limit)[0] == resource.RLIM_INFINITY
    return unlimited or bool(capabilities() >> CAP_IPC_LOCK & 1)


def capabilities() -> int:
    """Return the effective capabilities of this process as bits, or 0 where the system has none."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1], 16) for line in lines if line.startswith("CapEff:")), 0)


def switch_interval(interval: int) -> Undo:
    """Let a Python thread keep the GIL for `interval` (ns) where another wants it."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(interval / 1e9)
    return lambda: sys.setswitchinterval(before)


def uvloop_maker() -> Callable[[], asyncio.AbstractEventLoop]:
    """Return what makes event loops of uvloop's, with fine timers."""
    try:
        from rtagent.clock.uv import uvloop_loop

        uvloop_loop().close()
    except ImportError:
        raise RefusedError("uvloop is not installed: `pip install uvloop`.") from None
    except (OSError, AttributeError):
        raise RefusedError("uvloop was refused: this system has no timerfd for its timers; use Linux.") from None
    return uvloop_loop


def permission(capability: str, limit: str) -> str:
    """Return how a capability is granted to this Python, or a limit to its user."""
    if any(mark.exists() for mark in CONTAINER_MARKS):
        return f"start the container with `--cap-add {capability.upper()}`."
    python = Path(sys.executable).resolve()
    return (
        f"allow it with `sudo setcap cap_{capability}+ep {python}`, or with a line `{_user()} - {limit}` in "
        "/etc/security/limits.conf and a new login."
    )


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user whom the system has no name for
        return "*"
