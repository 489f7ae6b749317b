"""Measures cells, those that a store does not hold yet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtagent.errors import SweepError
from rtagent.sweeps.store import Cell, Row, Store, key_of
from rtagent.sweeps.workers import Measure, each


@dataclass(frozen=True)
class Finished:
    """A cell that is done: how long (s) measuring it took, and whether it was `kept` from before."""

    cell: Cell
    seconds: float
    kept: bool


@dataclass(frozen=True)
class Failure:
    """A cell that could not be measured, why in a sentence, and where."""

    cell: Cell
    sentence: str
    trace: str


class MeasuringError(SweepError):
    """Cells could not be measured; all others were, and are kept."""

    def __init__(self, failures: Sequence[Failure], cells: int) -> None:
        first = failures[0]
        super().__init__(
            f"{len(failures)} of {cells} could not be measured: {first.sentence.rstrip('.')}. "
            f"The first was {dict(first.cell)!s:.200}."
        )
        self.failures = failures


def _ignore(happened: object) -> None:
    """Tell nobody."""


def compute(
    measure: Measure,
    cells: Sequence[Cell],
    *,
    store: Path | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    finished: Callable[[Finished], None] = _ignore,
    damaged: Callable[[str], None] = _ignore,
) -> list[Row]:
    """Return what `measure` found of each cell, in their order.

    What the file `store` holds is taken from there, and what is measured is added to it at once, so that a sweep
    that was killed goes on where it was. `jobs` cells are measured at a time, each in a process of its own, or the
    workers of the Dask cluster whose scheduler is at `cluster` ("tcp://host:port") measure them. `finished` hears
    of each cell that is done, `damaged` of entries of the store that cannot be read, each in a sentence.

    Raises `MeasuringError` at the end where cells failed, and `SweepError` where it cannot go on; what was measured
    is kept in either case, as it is when it is interrupted.
    """
    with Store(store) as kept:
        for sentence in kept.damaged:
            damaged(sentence)
        keys = [key_of(measure, cell) for cell in cells]
        missing = _missing(kept, keys, cells, finished)
        failures = []
        for done in each(measure, missing, jobs, cluster):
            if done.failure:
                failures.append(Failure(cells[done.place], done.failure, done.trace))
            else:
                kept.put(keys[done.place], cells[done.place], done.found, done.seconds)
                finished(Finished(cells[done.place], done.seconds, kept=False))
        if failures:
            raise MeasuringError(failures, len(cells))
        return [found.row for key in keys if (found := kept.get(key)) is not None]


def _missing(
    kept: Store, keys: Sequence[str], cells: Sequence[Cell], finished: Callable[[Finished], None]
) -> list[tuple[int, Cell]]:
    """Return the cells that are to be measured, each once, with their places; tell of the others."""
    missing: dict[str, tuple[int, Cell]] = {}
    for place, (key, cell) in enumerate(zip(keys, cells, strict=True)):
        found = kept.get(key)
        if found is not None:
            finished(Finished(cell, found.seconds, kept=True))
        else:
            missing.setdefault(key, (place, cell))
    return list(missing.values())
