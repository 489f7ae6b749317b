"""How processes of telemetry behave beside the loops that they serve."""

from __future__ import annotations

import contextlib
import os

from rtagent.realtime.timeslice import usual_slice

NICENESS = 5


def give_way() -> None:
    """Run on any processor, and after a loop where both want the same one."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
    usual_slice()
