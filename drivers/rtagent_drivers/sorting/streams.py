"""Streams of the sorting arm: a session's trials, shuffled and put one after the other (thesis, section 4.3).

    python -m rtagent_drivers.sorting.streams mine.csv.gz --shuffle 3
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

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


class _Session(NamedTuple):
    """Rows of a session, shape (rows,) each, with the trial that each belongs to."""

    columns: dict[str, FloatArray]
    trials: NDArray[np.int64]


@cache
def _session(trials: int, seed: int) -> _Session:
    """Return what the arm's servos read at 30 Hz, from the first trial to the end of the last."""
    world = SortingWorld(trials)
    world.begin(0, stream(seed, "recording"))
    rows, numbers = [], []
    for row in range(len(world.objects) * 30 * int(RATE)):
        time = round(row * second / RATE)
        values = world.values(time)
        if values[ENDED]:
            break
        rows.append([float(values[name]) for name in world.spec.sensors if name != ENDED])
        numbers.append(world.trial_at(time))
    names = [name for name in world.spec.sensors if name != ENDED]
    return _Session(dict(zip(names, np.array(rows).T.copy(), strict=True)), np.array(numbers))


def sorting(*, shuffle: int = 0, trials: int = 30, seed: int = 1) -> Stream:
    """Return the stream number `shuffle` of a session of so many `trials` of each object.

    A stream of another number has the same trials in another order. Its ranges are the least and the greatest
    that is seen in the session, which all have in common.
    """
    columns, numbers = _session(trials, seed)
    order = np.random.default_rng((seed, shuffle)).permutation(numbers[-1] + 1)
    rows = np.concatenate([np.flatnonzero(numbers == number) for number in order])
    last = np.zeros(len(rows), dtype=np.bool_)
    last[-1] = True
    told = f"the simulated sorting arm: {len(order)} trials, {len(rows) / RATE / 60:.1f} min at {RATE:g} Hz"
    shuffled = {name: values[rows] for name, values in columns.items()}
    return Stream(shuffled, seen_ranges(columns), last, RATE, told)


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
