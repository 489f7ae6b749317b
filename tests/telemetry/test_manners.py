"""Processes of telemetry give way to the loop, by whomever they are started."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from rtagent.realtime import Realtime, manners, timeslice
from rtagent.realtime.machine import available_processors
from rtagent.telemetry.manners import NICENESS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="what is asked for is Linux's")

PROGRAM = """
import os
from rtagent.realtime.timeslice import time_slice
from rtagent.telemetry.manners import give_way
for _ in range(2):  # a router that a sender has started
    give_way()
    print(os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0), len(os.sched_getaffinity(0)), time_slice())
"""


def test_they_give_way_also_where_the_run_that_starts_them_does_not() -> None:
    usual, processors = timeslice.time_slice(), available_processors()
    niceness = max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0))
    with manners(Realtime(processors=(min(processors),))):
        done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    line = f"{os.SCHED_BATCH} {niceness} {len(processors)} {usual}"
    assert done.stdout.splitlines() == [line, line]
