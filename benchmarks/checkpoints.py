"""What checkpoints and replays cost: how long the loop is held up, and how late it is; files; a replay's time."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median

import numpy as np
from _harness import Row, main

from rtagent import clock, ms
from rtagent.checkpoint.file import read, write
from rtagent.checkpoint.keeper import Keeper, Rules
from rtagent.replay.journal import Journal
from rtagent.replay.replayer import Replayer, manner
from rtagent.scenario import Assembly, assemble, load
from rtagent.schedule import Component

SCENARIO = Path(__file__).parent.parent / "scenarios" / "stopping_horde.toml"
PACED = ["schedule.period=2ms", "schedule.observe=latest", 'devices.joint.onset=["1.2s","1.3s"]']
SIZES = {"2,576 demons": 22, "15,008 demons": 133}
BLOCKS = 4


class Starts:
    """Keeps when each observation began."""

    def __init__(self) -> None:
        self.times: list[int] = []

    def component(self, component: Component, start: int, end: int) -> None:
        """Keep it."""
        if component is Component.OBSERVE:
            self.times.append(start)


def assembly(bins: int, *overrides: str) -> Assembly:
    """Return the stopping task with a Horde beside it."""
    return assemble(load(SCENARIO, ["run.episodes=1", f"horde.demons.0.bins={bins}", *overrides]))


def lateness(bins: int, keeper: Keeper | None) -> list[float]:
    """Return by how much (µs) the cycles of a 500 Hz loop were apart otherwise than they should be."""
    starts = Starts()
    clock.run(assembly(bins, *PACED).run([starts], keeper=keeper))
    apart: list[float] = (np.abs(np.diff(starts.times) - 2 * ms) / 1e3).tolist()
    return apart


def keeping_rows(name: str, bins: int, folder: Path) -> Iterator[Row]:
    """Measure with and without checkpoints, in interleaved blocks."""
    late: dict[bool, list[float]] = {True: [], False: []}
    taken: list[int] = []
    path = folder / f"{bins}.ckpt"
    for block in range(2 * BLOCKS):
        keeper = Keeper(path, Rules(every=100 * ms, episodes=0)) if block % 2 else None
        late[keeper is not None] += lateness(bins, keeper)
        taken += keeper.taken if keeper is not None else []
    yield Row(f"{name}: size of the file", path.stat().st_size / 1e6, "MB")
    yield Row(f"{name}: the loop is held up, median", median(taken) / 1e6, "ms")
    yield Row(f"{name}: the loop is held up, longest", max(taken) / 1e6, "ms")
    for quantile in (50, 99):
        with_it, without = (float(np.percentile(late[kept], quantile)) for kept in (True, False))
        yield Row(f"{name}: lateness at 500 Hz, p{quantile}, ten a second", with_it, "µs")
        yield Row(f"{name}: the same without any", without, "µs")
    yield from file_rows(name, path)


def file_rows(name: str, path: Path) -> Iterator[Row]:
    """Measure reading and writing the file."""
    began = time.perf_counter()
    checkpoint = read(path)
    between = time.perf_counter()
    write(path, {}, checkpoint.saved)
    yield Row(f"{name}: writing, to the disk", 1e3 * (time.perf_counter() - between), "ms")
    yield Row(f"{name}: reading", 1e3 * (between - began), "ms")


def replay_rows() -> Iterator[Row]:
    """Measure a replay against the run that it is of."""
    recorded, journal = assembly(22), Journal()
    began = time.perf_counter()
    result = clock.run(recorded.run([journal]))
    run = time.perf_counter() - began
    again = assembly(22)
    how = manner(again.schedule, changed=False)
    replayer = Replayer(again.task, again.make_agent, again.schedule, again.plan.limits, again.plan.seed, how)
    began = time.perf_counter()
    outcome = replayer.replay(journal.events)
    replay = time.perf_counter() - began
    steps = sum(episode.steps for episode in result.episodes)
    yield Row("replay: choices, errors and weights that differ", float(not outcome.same), "", 0.0)
    yield Row("replay: for each transition", 1e6 * replay / steps, "µs")
    yield Row("replay: of the time of the run", replay / run, "×", 1.0)


def rows() -> Iterator[Row]:
    """Yield all figures."""
    with tempfile.TemporaryDirectory() as folder:
        for name, bins in SIZES.items():
            yield from keeping_rows(name, bins, Path(folder))
    yield from replay_rows()


def run(arguments: Sequence[str] | None = None) -> int:
    """Measure as the command line says."""
    return main(rows, __doc__, arguments)


if __name__ == "__main__":
    sys.exit(run())
