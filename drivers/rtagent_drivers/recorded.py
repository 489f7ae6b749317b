"""What was recorded, in memory: sessions of rows, which of them cannot be used, and what is to be told of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import FloatArray
from rtagent.specs import Spec
from rtagent.streams import stream
from rtagent.units import describe, second
from rtagent_drivers.fake import CLOSED_SETTINGS, World
from rtagent_drivers.tables import Table

IndexArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

GAP = 5.0
"""An interval longer than so many median intervals is a gap."""

KINDS = ("outside", "missing")
"""What can be wrong with a value: outside its range, or not there."""

HIGHEST_RATE = 1e5
"""A world is recorded at most so often (Hz)."""

LONGEST = 1e9
"""Times further apart than this (s) are none in seconds."""

TAIL = 0.005
REACH = 1.5
"""A guessed range leaves out what lies beyond the quantiles TAIL and 1 - TAIL by REACH times their distance."""

MARGIN = 0.05
"""A guessed range is by so much of its width wider, at either end, than the values in it."""


@dataclass(frozen=True)
class Signal:
    """Which column a signal is (the one of its own name, where left out), its range and unit.

    An end of the range that is left out is guessed from the values.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    column: str = ""
    low: float | None = None
    high: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class Session:
    """Rows in the order of their `times` (ns since the first), shape (rows,), with `values`, shape (rows, signals).

    `rows` are their numbers in the file. `missing` and `outside` have the shape of `values`; `gaps`, shape (rows,),
    says before which rows there is one. The rows `first` and `last` are usable, none before or after them is.
    """

    label: str
    rows: IndexArray
    times: IndexArray
    values: FloatArray
    missing: BoolArray
    outside: BoolArray
    gaps: BoolArray
    first: int
    last: int


@dataclass(frozen=True)
class Recording:
    """A recording: the specs of its signals, its sessions, and its median `interval` (ns; 0 where it has none).

    `remarks` are sentences on what was left out or guessed.
    """

    name: str
    specs: Mapping[str, Spec]
    sessions: Sequence[Session]
    interval: int
    remarks: Sequence[str] = ()

    def damage(self, session: Session, rows: slice) -> Counter[str]:
        """Return how many of these rows have each signal outside its range, or missing, or come after a gap."""
        counts = Counter({"gaps": int(session.gaps[rows].sum())})
        for kind, flags in zip(KINDS, (session.outside, session.missing), strict=True):
            for signal, count in zip(self.specs, flags[rows].sum(axis=0).tolist(), strict=True):
                counts[f"{signal}_{kind}"] = count
        return +counts

    def notes(self) -> Iterator[str]:
        """Yield a sentence on what it is, and one on each thing that may surprise."""
        length = sum(int(session.times[-1]) for session in self.sessions)
        count = sum(len(session.rows) for session in self.sessions)
        sessions = f"{len(self.sessions)} session{'s' if len(self.sessions) > 1 else ''}"
        yield (
            f"{self.name}: {count:,} rows of {len(self.specs)} signals in {sessions}, {describe(length)}, "
            f"one every {describe(self.interval)}."
        )
        yield from self.remarks
        yield from self._damage_notes(count)
        yield from self._gap_notes()

    def _damage_notes(self, count: int) -> Iterator[str]:
        damage = sum((self.damage(session, slice(None)) for session in self.sessions), Counter[str]())
        told = [
            f"{name} {kind} {found}" for name in self.specs for kind in KINDS if (found := damage[f"{name}_{kind}"])
        ]
        if told:
            bad = [session.rows[(session.missing | session.outside).any(axis=1)] for session in self.sessions]
            yield (
                f"{sum(map(len, bad)):,} of {count:,} rows hold values outside their range, or none, and are left "
                f"out: {', '.join(told)}; the first is row "
                f"{next(int(rows[0]) for rows in bad if rows.size)}."
            )

    def _gap_notes(self) -> Iterator[str]:
        gaps = [
            (int(session.times[row] - session.times[row - 1]), int(session.rows[row]))
            for session in self.sessions
            for row in np.flatnonzero(session.gaps)
        ]
        if gaps:
            longest, row = max(gaps)
            many = f"{len(gaps)} gaps are" if len(gaps) > 1 else "1 gap is"
            yield f"{many} longer than {GAP:g} intervals; the longest, {describe(longest)}, ends with row {row}."


def recording_of(table: Table, name: str, signals: Mapping[str, Signal] | None = None) -> Recording:
    """Make a recording of a table: of these signals, or of every column of numbers, their ranges guessed.

    Raises `SpecError`, naming row and column, where a time or a number is none, or where there is nothing to play.
    """
    remarks: list[str] = []
    if not len(table.times):
        raise SpecError(f"{name} has no rows: a recording has a row for each moment.")
    given = _every_number(table, name, remarks) if not signals else _picked(table, name, signals)
    specs = _specs(table, given, remarks)
    values = np.column_stack([table.columns[signal.column] for signal in given.values()])
    lows, highs = (np.array([getattr(spec, end) for spec in specs.values()]) for end in ("low", "high"))
    pieces = list(_sessions(table, name))
    intervals = np.concatenate([np.diff(times) for _, _, times in pieces])
    interval = float(np.median(intervals)) if intervals.size else 0.0
    sessions = [
        session
        for label, rows, times in pieces
        if (session := _session(label, rows, times, values[rows], lows, highs, GAP * interval)) is not None
    ]
    if not sessions:
        raise SpecError(
            f"{name} has no row in which every signal has a value within its range: there is nothing to play."
        )
    if len(sessions) < len(pieces):
        left_out = {label for label, _, _ in pieces} - {session.label for session in sessions}
        remarks.append(f"Without a usable row, and left out: session {', '.join(sorted(left_out))}.")
    return Recording(name, specs, sessions, round(interval), remarks)


def record(world: World, duration: int, rate: float, seed: int) -> Table:
    """Return what a file would give of a world, recorded for `duration` (ns) at `rate` (Hz): its scalar sensors.

    Raises `SpecError` where that cannot be.
    """
    if duration < 0 or not 0 < rate <= HIGHEST_RATE or seed < 0:
        raise SpecError(
            f"a duration of 0 or more, a rate up to {HIGHEST_RATE:g} Hz and a seed of 0 or more are needed."
        )
    world.begin(0, stream(seed, "recording"))
    times = [round(number * second / rate) for number in range(int(duration * rate / second) + 1)]
    values = [world.values(time) for time in times]
    columns = {
        name: np.array([float(each[name]) for each in values])
        for name, spec in world.spec.sensors.items()
        if not spec.shape
    }
    return Table(np.array(times) / second, [f"seed {seed}"] * len(times), columns)


def declared(world: World) -> dict[str, Signal]:
    """Return the scalar sensors of a world as signals with the ranges that it declares."""
    sensors = world.spec.sensors.items()
    return {name: Signal(name, spec.low, spec.high, spec.unit) for name, spec in sensors if not spec.shape}


def _picked(table: Table, name: str, signals: Mapping[str, Signal]) -> dict[str, Signal]:
    picked = {}
    for signal, given in signals.items():
        column = given.column or signal
        if column not in table.columns:
            raise SpecError(f"{name} has no column {column!r}{did_you_mean(column, list(table.columns))}")
        _check_numbers(table, name, column)
        picked[signal] = Signal(column, given.low, given.high, given.unit)
    return picked


def _check_numbers(table: Table, name: str, column: str) -> None:
    if column in table.texts:
        _, row, text = table.texts[column]
        raise SpecError(
            f"{name}, row {row}: {text!r} in column {column!r} is no number; leave a cell empty that has none."
        )
    if not np.isfinite(table.columns[column]).any():
        raise SpecError(f"{name}: column {column!r} has no values at all: leave it out.")


def _every_number(table: Table, name: str, remarks: list[str]) -> dict[str, Signal]:
    """Return a signal for each column that mostly holds numbers; say which do not."""
    mostly = {
        column: np.count_nonzero(np.isfinite(numbers)) > max(len(numbers) // 2, table.texts.get(column, (0,))[0])
        for column, numbers in table.columns.items()
    }
    names = [column for column, numeric in mostly.items() if numeric]
    if not names:
        raise SpecError(f"{name} has no column of numbers beside its times: there is nothing to play.")
    for column in names:
        _check_numbers(table, name, column)
    others = [column for column, numeric in mostly.items() if not numeric]
    if others:
        remarks.append(f"Not mostly numbers, and left out: {', '.join(others)}.")
    return {column: Signal(column) for column in names}


def _specs(table: Table, signals: Mapping[str, Signal], remarks: list[str]) -> dict[str, Spec]:
    specs, guessed = {}, []
    for name, signal in signals.items():
        low, high = signal.low, signal.high
        if low is None or high is None:
            bottom, top = guessed_range(table.columns[signal.column])
            low, high = bottom if low is None else low, top if high is None else high
            guessed.append(f"{name} {low:.4g} to {high:.4g}")
        try:
            specs[name] = Spec(unit=signal.unit, low=low, high=high)
        except SpecError as error:
            raise SpecError(f"signal {name!r}: {error}") from None
    if guessed:
        remarks.append(f"No ranges were declared; guessed from the values: {', '.join(guessed)}.")
    return specs


def guessed_range(numbers: FloatArray) -> tuple[float, float]:
    """Return a range that holds all but wild values (see REACH), as no glitch may set the scale of a signal."""
    finite = numbers[np.isfinite(numbers)]
    low, high = np.quantile(finite, (TAIL, 1.0 - TAIL))
    reach = REACH * (high - low)
    tame = finite[(finite >= low - reach) & (finite <= high + reach)] if reach > 0 else finite
    bottom, top = float(tame.min()), float(tame.max())
    margin = MARGIN * (top - bottom if top > bottom else max(1.0, abs(top)))
    return bottom - margin, top + margin


def _sessions(table: Table, name: str) -> Iterator[tuple[str, IndexArray, IndexArray]]:
    """Yield (label, places, times in ns since the first) of each session, in the order in which they begin."""
    labels, begins, member = np.unique(np.asarray(table.sessions), return_index=True, return_inverse=True)
    for number in np.argsort(begins):
        places = np.flatnonzero(member == number)
        seconds = table.times[places] - table.times[places[0]]
        backwards = np.flatnonzero(np.diff(seconds) <= 0)
        if backwards.size:
            raise SpecError(_backwards(table, name, places[backwards[0]], places[backwards[0] + 1]))
        if seconds[-1] > LONGEST:
            raise SpecError(
                f"{name}: the times in column {table.time!r} span {seconds[-1]:g} s: give them in seconds."
            )
        yield str(labels[number]), places, np.rint(seconds * second).astype(np.int64)


def _backwards(table: Table, name: str, before: int, row: int) -> str:
    times = f"{table.times[row]:.9g} s after {table.times[before]:.9g} s"
    return (
        f"{name}, row {row + 1}: the times in column {table.time!r} do not increase: {times}. Where another "
        "session begins there, say so in a column, and name it with session; else sort the rows."
    )


def _session(
    label: str,
    places: IndexArray,
    times: IndexArray,
    values: FloatArray,
    lows: FloatArray,
    highs: FloatArray,
    longest: float,
) -> Session | None:
    """Return a session, or None where no row of it is usable."""
    missing = np.isnan(values)
    outside = (values < lows) | (values > highs)
    usable = np.flatnonzero(~(missing | outside).any(axis=1))
    if not usable.size:
        return None
    gaps = np.diff(times, prepend=times[:1]) > longest
    ends = int(usable[0]), int(usable[-1])
    return Session(label, places + 1, times, values, missing, outside, gaps, *ends)
