"""Records as tables: one for each stream, and of samples one for each device, with a column for every number."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from rtagent.telemetry.reading import Entry, Scan, read_run
from rtagent.telemetry.records import Run

Columns = dict[str, str]
"""The columns of a table, with their kinds: int, float or str."""


class Tables:
    """The tables of a recording, by name, such as `sample.joint`; read twice, so that no file is too long.

    Raises `TelemetryError` where there is no recording.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._run = path, read_run(path)
        self.columns: dict[str, Columns] = {}
        for name, row in self._rows():
            columns = self.columns.setdefault(name, {})
            for column, value in row.items():
                columns[column] = _wider(columns.get(column, "int"), value)

    def write_csv(self, folder: Path) -> list[Path]:
        """Write a file for each table into `folder`; return them. Raises FileExistsError."""
        folder.mkdir()
        paths = {name: folder / f"{name}.csv" for name in self.columns}
        with ExitStack() as files:
            writers = {}
            for name, path in paths.items():
                file = files.enter_context(path.open("w", newline="", encoding="utf-8"))
                writers[name] = csv.DictWriter(file, list(self.columns[name]), restval="")
                writers[name].writeheader()
            for name, row in self._rows():
                writers[name].writerow({column: "" if value is None else value for column, value in row.items()})
        return list(paths.values())

    def write_npz(self, path: Path) -> None:
        """Write all columns as arrays called `table/column`; what is missing is NaN. Raises FileExistsError."""
        kept: dict[str, list[Any]] = {
            f"{name}/{column}": [] for name, columns in self.columns.items() for column in columns
        }
        for name, row in self._rows():
            for column in self.columns[name]:
                kept[f"{name}/{column}"].append(row.get(column))
        arrays = {
            f"{name}/{column}": _array(kept.pop(f"{name}/{column}"), kind)
            for name, columns in self.columns.items()
            for column, kind in columns.items()
        }
        save: Any = np.savez_compressed  # a name of its own could be a column's
        with path.open("xb") as file:
            save(file, **arrays)

    def _rows(self) -> Iterator[tuple[str, dict[str, Any]]]:
        for entry in Scan(self._path):
            if entry.stream != "run":
                yield _row(entry, self._run)


def _row(entry: Entry, run: Run) -> tuple[str, dict[str, Any]]:
    values = msgspec.json.decode(entry.data)
    ordered = {"time_ns": values.pop("time_ns"), "sequence": values.pop("sequence")} | values
    name = f"sample.{ordered.pop('device')}" if entry.stream == "sample" else entry.stream
    return name, dict(_flat(ordered, "", _names(entry.stream, run)))


def _names(stream: str, run: Run) -> dict[str, list[str]]:
    """Return what the numbers of a list are called."""
    if stream == "prediction":
        return {"values": [demon.name for demon in run.demons]}
    return {"state": run.state, "next_state": run.state} if stream == "transition" else {}


def _flat(value: Any, name: str, names: dict[str, list[str]]) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        items: Any = value.items()
    elif isinstance(value, list):
        items = zip(names.get(name) or range(len(value)), value, strict=False)
    else:
        yield name, value
        return
    for key, part in items:
        yield from _flat(part, f"{name}.{key}" if name else str(key), names)


def _wider(kind: str, value: Any) -> str:
    """Return the kind of a column that holds `value` too."""
    if isinstance(value, str) or kind == "str":
        return "str"
    if isinstance(value, int) and not isinstance(value, bool):
        return kind
    return kind if isinstance(value, bool) else "float"


def _array(values: list[Any], kind: str) -> np.ndarray:
    if kind == "str":
        return np.array(["" if value is None else str(value) for value in values])
    if kind == "int" and None not in values:
        return np.array(values, dtype=np.int64)
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
