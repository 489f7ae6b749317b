"""Streams of the sorting arm: a session's trials, shuffled and put one after the other (thesis, section 4.3).

python -m rtagent_drivers.sorting.streams mine.csv.gz --shuffle 3
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FloatArray
from rtagent.experiments.streams import Stream, seen_ranges
from rtagent.streams import stream
from rtagent.units import second
from rtagent_drivers.sorting.driver import RATE
from rtagent_drivers.sorting.world import ENDED, SortingWorld
from rtagent_drivers.tables import Table, write_table

Ranges = Literal["declared", "seen"]


class _Session(NamedTuple):
    """Rows of a session, shape (rows,) each, with the ranges that are declared, and the trial of each."""

    columns: dict[str, FloatArray]
    declared: dict[str, tuple[float, float]]
    trials: NDArray[np.int64]


@cache
def _session(trials: int, seed: int, wrist: bool) -> _Session:
    """Return what the arm's servos read at 30 Hz, from the first trial to the end of the last."""
    world = SortingWorld(trials, wrist=wrist)
    world.begin(0, stream(seed, "recording"))
    sensors = {name: spec for name, spec in world.spec.sensors.items() if name != ENDED}
    rows, numbers = [], []
    for row in range(len(world.objects) * 30 * int(RATE)):
        time = round(row * second / RATE)
        values = world.values(time)
        if values[ENDED]:
            break
        rows.append([float(values[name]) for name in sensors])
        numbers.append(world.trial_at(time))
    declared = {name: (spec.low, spec.high) for name, spec in sensors.items()}
    return _Session(dict(zip(sensors, np.array(rows).T.copy(), strict=True)), declared, np.array(numbers))


def sorting(
    *, shuffle: int = 0, trials: int = 30, seed: int = 1, wrist: bool = False, ranges: Ranges = "declared"
) -> Stream:
    """Return the stream number `shuffle` of a session of so many `trials` of each object.

    A stream of another number has the same trials in another order. Ranges are those that the arm declares, or the
    least and the greatest that is `seen` in the session.
    """
    session = _session(trials, seed, wrist)
    order = np.random.default_rng((seed, shuffle)).permutation(session.trials[-1] + 1)
    rows = np.concatenate([np.flatnonzero(session.trials == number) for number in order])
    last = np.zeros(len(rows), dtype=np.bool_)
    last[-1] = True
    told = f"the simulated sorting arm: {len(order)} trials, {len(rows) / RATE / 60:.1f} min at {RATE:g} Hz"
    shuffled = {name: values[rows] for name, values in session.columns.items()}
    return Stream(shuffled, session.declared if ranges == "declared" else seen_ranges(shuffled), last, RATE, told)


def main(argv: Sequence[str] | None = None) -> None:
    """Write a stream to a file."""
    parser = argparse.ArgumentParser(prog="python -m rtagent_drivers.sorting.streams", description=main.__doc__)
    parser.add_argument("file", type=Path, help="where to: its name ends in .csv, .csv.gz or .npz")
    parser.add_argument("--shuffle", type=int, default=0, help="the number of the stream")
    parser.add_argument("--trials", type=int, default=30, help="of each object")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(argv)
    try:
        made = sorting(shuffle=given.shuffle, trials=given.trials, seed=given.seed)
        times = np.arange(len(made.last)) / RATE
        labels = [f"seed {given.seed}, shuffle {given.shuffle}"] * len(times)
        write_table(Table(times, labels, dict(made.columns)), given.file)
    except (SpecError, OSError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
