"""Measures recordings: how long one takes to load, and what each of its rows costs a run that only predicts."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from _harness import Row, main

from rtagent import Agent, Plan, Result, Schedule, clock, run
from rtagent.features import Binned
from rtagent.learning import TD
from rtagent.schedule import LEARN, OBSERVE
from rtagent.tasks import Signals
from rtagent_drivers.recording import RecordingDevice, recording
from rtagent_drivers.tables import Table, write_table

ROWS, SIGNALS = 20_000, 18
ROUNDS = 5


def write(folder: Path) -> Path:
    """Write six sessions of random numbers at 10 Hz."""
    rng = np.random.default_rng(1)
    labels = [f"session {6 * row // ROWS}" for row in range(ROWS)]
    columns = {f"signal_{number}": rng.random(ROWS).round(6) for number in range(SIGNALS)}
    path = folder / "recording.csv.gz"
    write_table(Table(np.arange(ROWS) / 10.0, labels, columns), path)
    return path


def load_time(path: Path) -> float:
    """Return how long (s) a device takes to be made of a file."""
    start = time.perf_counter()
    recording(file=str(path))
    return time.perf_counter() - start


def row_time(device: RecordingDevice) -> float:
    """Return what a row costs (µs): played, observed by the task, coded by one bin, learned by TD."""
    task = Signals(reward="arm.signal_0")
    task.bind({"arm": device.spec})
    features = Binned(state=task.state, bins=1)
    schedule = Schedule((OBSERVE, LEARN))

    async def predict() -> Result:
        return await run(
            {"arm": device}, task, Agent(features, TD(size=1)), schedule, Plan(episodes=device.episodes)
        )

    start = time.perf_counter()
    result = clock.run(predict(), "virtual")
    return (time.perf_counter() - start) / sum(episode.steps for episode in result.episodes) * 1e6


def rows() -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder))
        loads = [load_time(path) for _ in range(ROUNDS)]
        costs = [row_time(recording(file=str(path))) for _ in range(ROUNDS)]
    yield Row(f"load {ROWS:,} rows of {SIGNALS} signals, gzipped CSV", min(loads), "s", 0.5)
    yield Row("a row, played, observed and learned in virtual time", min(costs), "µs", 60.0)


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
