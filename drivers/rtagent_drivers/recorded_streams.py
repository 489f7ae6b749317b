"""Recordings as streams: of CSV, gzipped CSV and npz files, and of runs recorded with `rtagent run --record`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from rtagent.errors import SpecError
from rtagent.experience import FloatArray, Observation
from rtagent.experiments.streams import Stream
from rtagent.replay.events import Began, Observed
from rtagent.replay.mcap import read_recording
from rtagent.units import second
from rtagent_drivers.recorded import Recording, Session, Signal, guessed_range, recording_of
from rtagent_drivers.tables import Table, read_table

POSITION, VELOCITY = "_position", "_velocity"

Ends = Sequence[float] | None


def recorded_stream(*, file: str, shuffle: int = -1, signals: Mapping[str, Ends] | None = None) -> Stream:
    """Return what a file holds, its sessions in their own order, or in that number `shuffle` has drawn.

    `signals` are those that are wanted, each with its range (None: guessed from the values); without it every
    column of numbers is. Rows in which a value is missing or outside its range are left out. A joint that has a
    column `NAME_position` and none `NAME_velocity` is given one: the differences of its positions over time.
    Raises `SpecError` for what cannot be read.
    """
    table, wanted = _table(file), dict(signals or {})
    made = {name: wanted.pop(name) for name in list(wanted) if _is_made(name, table.columns)}
    given = {name: Signal(name, *(ends or (None, None))) for name, ends in wanted.items()}
    recording = recording_of(table, Path(file).name, given or None)
    sessions = [_rows(recording, session) for session in recording.sessions]
    if shuffle >= 0:
        sessions = [sessions[place] for place in np.random.default_rng(shuffle).permutation(len(sessions))]
    columns = {name: np.concatenate([each[name] for each in sessions]) for name in sessions[0]}
    last = np.zeros(len(next(iter(columns.values()))), dtype=np.bool_)
    last[np.cumsum([len(next(iter(each.values()))) for each in sessions]) - 1] = True
    declared = {name: (spec.low, spec.high) for name, spec in recording.specs.items()}
    declared |= {name: (ends[0], ends[1]) for name, ends in made.items() if ends is not None}
    guessed = {name: guessed_range(values) for name, values in columns.items() if name not in declared}
    rate = second / recording.interval if recording.interval else 0.0
    told = f"{recording.name}: {len(last):,} rows in {len(sessions)} sessions, {rate:.3g} Hz"
    return Stream(columns, declared | guessed, last, rate, told)


def _is_made(name: str, columns: Mapping[str, FloatArray]) -> bool:
    """Return whether a signal is made of another column, having none of its own."""
    position = name.removesuffix(VELOCITY) + POSITION
    return name not in columns and name.endswith(VELOCITY) and position in columns


def _rows(recording: Recording, session: Session) -> dict[str, FloatArray]:
    """Return the usable rows of a session by signal, with velocities."""
    usable = ~(session.missing | session.outside).any(axis=1)
    names, values = list(recording.specs), session.values[usable]
    columns = {name: values[:, place].copy() for place, name in enumerate(names)}
    times = session.times[usable] / second
    for name in names:
        moved = name.removesuffix(POSITION) + VELOCITY
        if name.endswith(POSITION) and moved not in columns:
            columns[moved] = np.diff(columns[name], prepend=columns[name][:1]) / np.diff(times, prepend=-1.0)
    return columns


@lru_cache(maxsize=2)
def _table(file: str) -> Table:
    return _of_a_run(Path(file)) if file.endswith(".mcap") else read_table(Path(file))


def _of_a_run(path: Path) -> Table:
    """Return what was observed in a recorded run, a row for each observation; each episode is a session."""
    rows: list[tuple[float, str, dict[str, float]]] = []
    label = ""
    for event in read_recording(path).events:
        if isinstance(event, Began):
            label = f"trial {event.trial}, episode {event.episode}"
        elif isinstance(event, Observed):
            rows.append((event.observation.time / second, label, _numbers(event.observation)))
    if not rows:
        raise SpecError(f"{path} has no observations: record a run that observes something.")
    columns = {name: np.array([row[2].get(name, np.nan) for row in rows]) for name in rows[0][2]}
    return Table(np.array([row[0] for row in rows]), [row[1] for row in rows], columns)


def _numbers(observation: Observation) -> dict[str, float]:
    """Return every number observed, called as its sensor is."""
    sensed = [item for sample in observation.samples.values() for item in sample.values.items()]
    return {name: float(value) for name, value in sensed if not isinstance(value, bool | np.ndarray)}
