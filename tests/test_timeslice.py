"""The short time slice of a run: asked for quietly, kept from processes that are to give way, and given back."""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rtagent.commands.findings import findings
from rtagent.realtime import Realtime, manners, timeslice

HAS_SLICES = timeslice.time_slice() > 0
only_with_slices = pytest.mark.skipif(not HAS_SLICES, reason="this kernel has no time slices of single threads")


@pytest.fixture(autouse=True)
def left_as_it_was() -> Iterator[None]:
    """Fail where a test leaves anything behind."""
    before = timeslice.time_slice()
    yield
    assert timeslice.time_slice() == before


def in_thread(work: Callable[[], None]) -> None:
    """Do in a thread of its own what changes the scheduling of a thread for good."""
    failed: list[BaseException] = []

    def caught() -> None:
        try:
            work()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=caught)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]


def told_by_kernel() -> int:
    """Return the slice (ns) of this process as /proc tells it; 0 where it does not."""
    lines = Path("/proc/thread-self/sched").read_text().splitlines() if Path("/proc/self/sched").exists() else []
    return next((int(line.split(":")[1]) for line in lines if line.startswith("se.slice")), 0)


@only_with_slices
def test_it_is_asked_for_and_given_back() -> None:
    before = timeslice.time_slice()
    with manners(Realtime()) as granted:
        assert timeslice.time_slice() == timeslice.SHORTEST < before
        assert granted.as_dict() == {"granted": ["time slice 100 µs"], "refused": []}
    assert timeslice.time_slice() == before


@only_with_slices
def test_the_kernel_tells_the_same() -> None:
    if not told_by_kernel():
        pytest.skip("this kernel does not tell: what it answers to the call is tested above")
    assert told_by_kernel() == timeslice.time_slice()
    with manners(Realtime()):
        assert told_by_kernel() == timeslice.SHORTEST


@only_with_slices
def test_it_is_given_back_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), manners(Realtime()):
        raise ZeroDivisionError


def test_nothing_is_asked_for_under_the_virtual_clock() -> None:
    before = timeslice.time_slice()
    with manners(Realtime(), "virtual") as granted:
        assert timeslice.time_slice() == before
        assert granted.granted == []


@only_with_slices
def test_niceness_and_policy_stay_as_they_are() -> None:
    def work() -> None:
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 7)
        with manners(Realtime()):
            assert timeslice.time_slice() == timeslice.SHORTEST
            assert os.sched_getscheduler(0) == os.SCHED_BATCH
            assert os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) == 7

    in_thread(work)


@only_with_slices
def test_a_priority_that_is_given_up_leaves_the_short_slice() -> None:
    def work() -> None:
        with manners(Realtime(priority=7)) as granted:
            if granted.refused:
                pytest.skip("this machine allows no SCHED_FIFO")
            assert timeslice.time_slice() == 0
            assert granted._give_priority_up is not None
            granted._give_priority_up()
            assert timeslice.time_slice() == timeslice.SHORTEST

    in_thread(work)


@only_with_slices
def test_a_process_that_gives_way_has_the_usual_slice_again() -> None:
    program = (
        "from rtagent.realtime import timeslice as t; before = t.time_slice(); t.usual_slice(); "
        "print(before, t.time_slice())"
    )
    usual = timeslice.time_slice()
    with manners(Realtime()):
        said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert said.split() == [str(timeslice.SHORTEST), str(usual)]


@pytest.mark.parametrize("lacking", ["architecture", "system", "call", "policy"])
def test_a_system_without_slices_is_asked_for_nothing(monkeypatch: pytest.MonkeyPatch, lacking: str) -> None:
    with monkeypatch.context() as patch:
        if lacking == "architecture":
            patch.setattr(platform, "machine", lambda: "vax")
        elif lacking == "system":
            patch.setattr(sys, "platform", "darwin")
        elif lacking == "call":  # a kernel, or a filter of system calls, that knows it not
            patch.setattr(timeslice, "CALLS", dict.fromkeys(timeslice.CALLS, (100_000, 100_001)))
        else:
            patch.setattr(timeslice, "ORDINARY", ())
        with manners(Realtime()) as granted:
            assert granted.as_dict() == {"granted": [], "refused": []}
        timeslice.usual_slice()
        (found,) = (finding for finding in findings() if finding.name == "time slice")
    assert "6.12" in found.cure
    assert found.problem


def test_an_older_kernel_that_takes_a_slice_and_forgets_it_grants_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(which: int, *args: object) -> int:
        return 0  # it fills in no `sched_runtime`

    with monkeypatch.context() as patch:
        patch.setattr(timeslice, "_call", answer)
        with manners(Realtime()) as granted:
            assert granted.granted == []


def test_the_structure_is_as_long_as_the_kernels_first_version() -> None:
    assert ctypes.sizeof(timeslice.Attributes) == 48


LATE = """
import contextlib, sys, time
from rtagent.realtime import Realtime, manners
with manners(Realtime()) if sys.argv[1] == "short" else contextlib.nullcontext():
    late = []
    while len(late) < 400:
        due = time.monotonic_ns() + 2_000_000
        time.sleep(0.002)
        late.append(time.monotonic_ns() - due)
        end = time.monotonic_ns() + 400_000
        while time.monotonic_ns() < end:
            pass
print(sorted(late)[int(0.98 * len(late))])
"""
"""A loop that computes for a fifth of the time, and how late (ns) one in fifty of its cycles begins."""


@only_with_slices
@pytest.mark.slow
def test_beside_programs_that_keep_all_processors_busy_it_wakes_less_late() -> None:
    """In the best of five rounds that take turns: machines are noisy."""
    with contextlib.ExitStack() as stack:
        for _ in range(os.cpu_count() or 1):
            hog = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(hog.kill)
        assert min(late("short") / late("usual") for _ in range(5)) < 0.5


def late(way: str) -> int:
    return int(subprocess.run([sys.executable, "-c", LATE, way], capture_output=True, check=True).stdout)
