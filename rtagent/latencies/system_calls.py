"""System calls a cycle, by name: counted by strace, in a process of its own; else reads and writes only.

A run is made twice, the second with twice the episodes: what is more in the second, for each cycle that it has
more, is of the cycles; starting and ending cancel out. Without strace, or where it may not trace, the kernel's own
count of this process is taken, which knows reads and writes only (/proc/self/io: syscr, syscw).
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from rtagent.errors import SpecError, UndecidedError
from rtagent.latencies.counts import Counts
from rtagent.latencies.subject import Subject
from rtagent.schedule import OBSERVE

IO = Path("/proc/self/io")
DIGITS = 2
"""What happens less than once in 200 cycles is no part of a cycle."""

MEMORY = frozenset({"brk", "mmap", "munmap", "mremap", "madvise"})
"""Python asks for memory now and then: that is a part of a cycle only where it is in half of them."""

ONLY_IO = "(strace is not there or may not trace: only reads and writes were counted)"

Counted = tuple[Mapping[str, int], int]
"""System calls by name, and cycles."""


def system_calls(subject: Subject, episodes: int = 20) -> Counts:
    """Return the system calls of a scenario in each cycle, from runs of so many episodes and of twice as many.

    Raises `SpecError` where `subject` is no scenario, or there is neither strace nor /proc/self/io.
    """
    if episodes < 1:
        raise SpecError("episodes is 1 or more.")
    measure, note = _measure()
    (few, cycles), (many, more) = (
        measure(subject.with_keys("run.trials=1", f"run.episodes={n}")) for n in (episodes, 2 * episodes)
    )
    if more <= cycles:
        raise UndecidedError(f"{subject.name} has no more cycles in {2 * episodes} episodes than in {episodes}.")
    rates = {name: round((count - few.get(name, 0)) / (more - cycles), DIGITS) for name, count in many.items()}
    made = {name: rate for name, rate in rates.items() if rate > (0.5 if name in MEMORY else 0.0)}
    return Counts("system calls", subject.name, made, note)


def _measure() -> tuple[Callable[[Subject], Counted], str]:
    if _may_trace():
        return _by_strace, ""
    if IO.exists():
        return _by_kernel, ONLY_IO
    raise SpecError("system calls cannot be counted here: install strace, or use Linux.")


def _may_trace() -> bool:
    strace = shutil.which("strace")
    if strace is None:
        return False
    return subprocess.run([strace, "-qq", "-o", "/dev/null", "true"], capture_output=True).returncode == 0  # noqa: S603


def _by_strace(subject: Subject) -> Counted:
    with tempfile.TemporaryDirectory() as folder:
        table, result = Path(folder) / "calls", Path(folder) / "result.json"
        keys = [word for key in subject.overrides for word in ("--set", key)]
        run = [sys.executable, "-m", "rtagent", "run", str(subject.path), "--quiet", "--json", str(result), *keys]
        done = subprocess.run(["strace", "-f", "-c", "-o", str(table), *run], capture_output=True, text=True)  # noqa: S603, S607
        if not result.exists() or not table.exists():
            raise SpecError(f"{subject.name} did not run under strace: {done.stderr.strip()}")
        cycles = json.loads(result.read_text())["components"][OBSERVE.value]["count"]
        return _table(table.read_text()), cycles


def _table(text: str) -> dict[str, int]:
    """Read strace's table: time, seconds, µs a call, calls, errors (or nothing), name."""
    rows = (line.split() for line in text.splitlines())
    return {row[-1]: int(row[3]) for row in rows if len(row) >= 5 and row[3].isdigit() and row[-1] != "total"}


def _by_kernel(subject: Subject) -> Counted:
    before = _io()
    result = subject.run()
    after = _io()
    made = {name: after[key] - before[key] for name, key in (("read", "syscr"), ("write", "syscw"))}
    return made, result.recorder.components[OBSERVE].count


def _io() -> dict[str, int]:
    return {name: int(value) for name, value in (line.split(": ") for line in IO.read_text().splitlines())}
