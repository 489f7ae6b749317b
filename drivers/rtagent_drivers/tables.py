"""Tables of numbers over time, from files and to files: CSV, gzipped CSV, npz.

Row 1 is the first below the header. What is missing is NaN; nothing is mended.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import FloatArray
from rtagent.memory import claim

BLOCK = 10_000
"""Rows that are held as text at a time."""

MISSING = frozenset({"", "na", "n/a", "nan", "null", "none"})
TIME_NAMES = ("t", "time", "timestamp", "seconds", "datetime")
SESSION_NAMES = ("session",)
UNREADABLE = (OSError, EOFError, UnicodeDecodeError, ValueError, csv.Error, zlib.error, zipfile.BadZipFile)


@dataclass(frozen=True)
class Layout:
    """Which columns of a file are the time, the session (empty: there is one session) and the signals."""

    time: str
    session: str
    signals: tuple[str, ...]


@dataclass
class Table:
    """Rows over time: `times` (s, from any origin), `sessions` (a label for each row), shape (rows,) each.

    `columns` has the numbers by column, shape (rows,), NaN where one is missing; `texts` says, by column, how many
    cells hold text instead, and the row and text of the first. `time` is what the column of times is called.
    """

    times: FloatArray
    sessions: Sequence[str]
    columns: dict[str, FloatArray]
    texts: dict[str, tuple[int, int, str]] = field(default_factory=dict)
    time: str = "t"


def read_table(path: Path, time: str = "", session: str = "", wanted: Sequence[str] = ()) -> Table:
    """Read a file; without `wanted` every column but time and session. Raises `SpecError` where it cannot be."""
    with _readable(path), path.open("rb") as file:
        head = file.read(2)
        file.seek(0)
        if not head:
            raise SpecError(f"{path} is empty: a recording has a header, and a row for each moment.")
        if head == b"PK":
            return _read_npz(path, file, time, session, wanted)
        plain: Any = gzip.GzipFile(fileobj=file) if head == b"\x1f\x8b" else file
        with io.TextIOWrapper(plain, encoding="utf-8-sig", newline="") as lines:
            return _read_csv(path, lines, time, session, wanted)


def write_table(table: Table, path: Path) -> None:
    """Write a table, as the name of the file says: `.npz`, `.csv.gz`, else CSV; it is read again exactly."""
    if path.suffix == ".npz":
        named: dict[str, Any] = {"session": np.asarray(table.sessions), "t": table.times} | table.columns
        np.savez_compressed(path, **named)
        return
    if path.suffix == ".gz":
        with gzip.open(path, "wt", encoding="utf-8", newline="") as lines:
            _write_csv(table, lines)
    else:
        with path.open("w", encoding="utf-8", newline="") as lines:
            _write_csv(table, lines)


def _write_csv(table: Table, lines: IO[str]) -> None:
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow(["session", "t", *table.columns])
    numbers = (array.tolist() for array in (table.times, *table.columns.values()))
    writer.writerows(zip(table.sessions, *numbers, strict=True))


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except SpecError:
        raise
    except FileNotFoundError:
        near = sorted(each.name for each in path.parent.glob("*")) if path.parent.is_dir() else []
        hint = did_you_mean(path.name, near) if len(near) < 20 else "."
        raise SpecError(f"there is no file {path}{hint}") from None
    except UNREADABLE as error:
        raise SpecError(f"{path} cannot be read as CSV, gzipped CSV or npz: {error}.") from None


def find_layout(path: Path, names: Sequence[str], time: str, session: str, wanted: Sequence[str]) -> Layout:
    """Return which of the columns `names` are what; raise `SpecError` where one is not there, or there twice."""
    twice = {name for name in names if list(names).count(name) > 1}
    if twice:
        raise SpecError(f"{path} has the column {min(twice)!r} twice: give each column a name of its own.")
    for name in (time, session, *wanted):
        if name and name not in names:
            raise SpecError(f"{path} has no column {name!r}{did_you_mean(name, list(names))}")
    time = time or _named_like(names, TIME_NAMES)
    if not time:
        raise SpecError(
            f"{path} has no column of times that can be known by its name: say which it is with time, "
            f"one of {', '.join(names)} (the first row holds the names of the columns)."
        )
    session = session or _named_like(names, SESSION_NAMES)
    signals = tuple(wanted) or tuple(name for name in names if name not in (time, session, ""))
    return Layout(time, session, signals)


def _named_like(names: Sequence[str], usual: Sequence[str]) -> str:
    found = {name.lower(): name for name in reversed(names)}
    return next((found[name] for name in usual if name in found), "")


def _read_csv(path: Path, lines: io.TextIOBase, time: str, session: str, wanted: Sequence[str]) -> Table:
    first = next(iter(lines), "")
    delimiter = max(",;\t", key=re.sub(r'"[^"]*"', "", first).count)
    names = [name.strip() for name in next(csv.reader([first], delimiter=delimiter), [])]
    layout = find_layout(path, names, time, session, wanted)
    times = _TimeColumn(path, layout.time)
    sessions: list[str] = []
    columns = {name: _NumberColumn() for name in layout.signals}
    rows = (row for row in csv.reader(lines, delimiter=delimiter) if row)
    while block := list(islice(rows, BLOCK)):
        _check_widths(path, block, len(names), times.rows)
        cells = dict(zip(names, zip(*block, strict=True), strict=True))
        sessions += cells[layout.session] if layout.session else [""] * len(block)
        for name, column in columns.items():
            column.add(cells[name], times.rows)
        times.add(cells[layout.time])
    claim(times.rows * (len(columns) + 1) * 8, f"the recording {path}")
    texts = {name: column.first_text for name, column in columns.items() if column.first_text[0]}
    return Table(
        times.finish(), sessions, {name: column.finish() for name, column in columns.items()}, texts, layout.time
    )


def _check_widths(path: Path, block: Sequence[Sequence[str]], width: int, before: int) -> None:
    if set(map(len, block)) != {width}:
        place, row = next((place, row) for place, row in enumerate(block) if len(row) != width)
        raise SpecError(
            f"{path}, row {before + place + 1}: it has {len(row)} cells, and the header {width}: mend or delete it."
        )


class _NumberColumn:
    """Collects a column of numbers; texts among them become NaN, and are counted."""

    def __init__(self) -> None:
        self._blocks: list[FloatArray] = []
        self.first_text = (0, 0, "")

    def add(self, cells: Sequence[str], before: int) -> None:
        """Take a block of cells that follow `before` rows."""
        try:
            numbers = list(map(float, cells))
        except ValueError:
            numbers = [self._number(cell, before + place) for place, cell in enumerate(cells, 1)]
        self._blocks.append(np.array(numbers, dtype=np.float64))

    def finish(self) -> FloatArray:
        """Return all numbers, shape (rows,)."""
        return np.concatenate(self._blocks) if self._blocks else np.empty(0)

    def _number(self, cell: str, row: int) -> float:
        try:
            return float(cell)
        except ValueError:
            pass
        if cell.strip().lower() not in MISSING:
            count, first, text = self.first_text
            self.first_text = (count + 1, first or row, text or cell)
        return float("nan")


class _TimeColumn:
    """Collects a column of times: seconds as numbers, or ISO 8601 stamps, as the first one is written."""

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, name
        self._blocks: list[FloatArray] = []
        self._seconds: Callable[[str], float] | None = None
        self.rows = 0

    def add(self, cells: Sequence[str]) -> None:
        """Take a block of cells; raise `SpecError`, naming the row, for one that is no time."""
        seconds = self._seconds = self._seconds or _way_to_read(cells[0])
        try:
            block = np.array([seconds(cell) for cell in cells], dtype=np.float64)
        except ValueError:
            self._blame(next(place for place, cell in enumerate(cells) if not _works(seconds, cell)), cells)
        if not np.isfinite(block).all():
            self._blame(int(np.argmin(np.isfinite(block))), cells)
        self._blocks.append(block)
        self.rows += len(cells)

    def finish(self) -> FloatArray:
        """Return all times (s), shape (rows,)."""
        return np.concatenate(self._blocks) if self._blocks else np.empty(0)

    def _blame(self, place: int, cells: Sequence[str]) -> None:
        raise SpecError(
            f"{self._path}, row {self.rows + place + 1}: {cells[place]!r} in column {self._name!r} is no time: "
            "write all times as numbers of seconds, or all as stamps such as 2024-05-03T16:39:00.250Z."
        )


def _way_to_read(cell: str) -> Callable[[str], float]:
    if _works(float, cell):
        return float
    if not _works(_stamp, cell):
        return float
    origin = _stamp(cell)
    return lambda text: (
        _stamp(text) - origin
    ).total_seconds()  # exact to the microsecond, as seconds since 1970 are not


def _works(read: Callable[[str], object], cell: str) -> bool:
    try:
        read(cell)
    except ValueError:
        return False
    return True


def _stamp(text: str) -> datetime:
    stamp = datetime.fromisoformat(text.strip())
    return stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)


def _read_npz(path: Path, file: IO[bytes], time: str, session: str, wanted: Sequence[str]) -> Table:
    with np.load(file, allow_pickle=False) as archive:
        layout = find_layout(path, archive.files, time, session, wanted)
        picked = {name: archive[name] for name in {layout.time, layout.session, *layout.signals} - {""}}
    times = _npz_times(path, layout.time, picked[layout.time])
    for name, array in picked.items():
        if array.shape != times.shape:
            raise SpecError(
                f"{path}: the array {name!r} has shape {array.shape}, not {times.shape} as the times have."
            )
    sessions = picked[layout.session].astype(str).tolist() if layout.session else [""] * len(times)
    columns = {name: picked[name] for name in layout.signals}
    texts = {name: (len(times), 1, str(array[0])) for name, array in columns.items() if _is_text(array)}
    numbers = {
        name: np.full(times.shape, np.nan) if name in texts else array.astype(np.float64)
        for name, array in columns.items()
    }
    return Table(times, sessions, numbers, texts, layout.time)


def _npz_times(path: Path, name: str, array: Any) -> FloatArray:
    if array.ndim != 1:
        raise SpecError(f"{path}: the array {name!r} has shape {array.shape}: a recording has one number a row.")
    column = _TimeColumn(path, name)
    if array.dtype.kind == "M":
        array = (array - array[:1]) / np.timedelta64(1, "s")
    if array.size:
        column.add(array.tolist() if array.dtype.kind in "iuf" else [str(cell) for cell in array.tolist()])
    return column.finish()


def _is_text(array: Any) -> bool:
    return array.dtype.kind not in "biuf" and array.size > 0
