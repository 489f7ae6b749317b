"""Measures the warm start of the command line: to its help, and to the first line of a run's progress."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from _harness import Row, main

COMMAND = str(Path(sys.executable).with_name("rtagent"))
SCENARIO = str(Path(__file__).resolve().parent.parent / "scenarios" / "stopping.toml")
RUNS = 11


def until_help() -> float:
    """Return how long (s) the help takes, to its end."""
    start = time.perf_counter()
    subprocess.run([COMMAND, "--help"], stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def until_first_line() -> float:
    """Return how long (s) a run takes to its first line on a pipe."""
    start = time.perf_counter()
    with subprocess.Popen([COMMAND, "run", SCENARIO], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        elapsed = time.perf_counter() - start
        process.kill()
    if not line:
        raise RuntimeError("rtagent run ended without a line of progress: try the command by hand.")
    return elapsed


def rows() -> Iterator[Row]:
    kinds = {"help": until_help, "run": until_first_line}
    rounds = [{name: kind() for name, kind in kinds.items()} for _ in range(RUNS + 1)][1:]
    yield Row("rtagent --help", median(times["help"] for times in rounds), "s", 0.3)
    yield Row("rtagent run, to the first line of progress", median(times["run"] for times in rounds), "s", 1.0)


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
