"""What an experiment is, and what it finds: claims with verdicts, figures, tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Cell = Mapping[str, Any]
"""What one measurement is told, as plain data (JSON): its parameters and its seed, and nothing else decides it."""
Row = Mapping[str, Any]
"""What one measurement found, as plain data (JSON)."""


class Verdict(StrEnum):
    """What the data say about a claim of the thesis."""

    REPRODUCED = "reproduced"
    NOT_REPRODUCED = "not reproduced"
    DIFFERS = "differs"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Claim:
    """A claim of the thesis beside what was found, with their numbers; `because` explains where they differ."""

    said: str
    theirs: str
    ours: str
    verdict: Verdict
    because: str = ""


@dataclass(frozen=True)
class Figure:
    """A figure, drawn only where it is wanted; `name` is that of its files, `size` is in inches."""

    name: str
    caption: str
    draw: Callable[[Canvas], None]
    size: tuple[float, float] = (7.0, 4.0)


@dataclass(frozen=True)
class Table:
    """A table of texts."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Findings:
    """All that an experiment found."""

    claims: tuple[Claim, ...] = ()
    figures: tuple[Figure, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Options:
    """How an experiment is to be done: a smaller one in a few minutes (`quick`), on a recording (`data`)."""

    quick: bool = False
    data: Path | None = None


@dataclass(frozen=True)
class Experiment:
    """An experiment that can be divided among processes and gone on with.

    `cells` lists all that is to be measured, `measure`, a function of a module, measures one in some process,
    and `find` is given the cells with their rows, in the order of the cells. `seconds` estimates how long one
    processor needs for a cell. `models` says what its simulated devices model, and what they do not.

    `alone`: what it measures are times, so that nothing else is measured meanwhile. `on_demand`: it is done where
    it is named, and is no part of all.
    """

    name: str
    title: str
    thesis: str
    cells: Callable[[Options], Sequence[Cell]]
    measure: Callable[[Cell], Row]
    find: Callable[[Sequence[tuple[Cell, Row]], Options], Findings]
    seconds: Callable[[Cell], float]
    models: tuple[str, ...] = field(default=())
    alone: bool = False
    on_demand: bool = False
