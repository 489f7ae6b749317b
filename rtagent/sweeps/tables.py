"""Results of sweeps as files: CSV, or Parquet; each appears whole, or not at all."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rtagent.errors import SweepError

Rows = Sequence[Mapping[str, Any]]


def check_place(path: Path) -> None:
    """Raise `SweepError` where no table can be written to, or nothing knows how."""
    if path.suffix not in WRITERS:
        raise SweepError(f"--out {path}: the name ends with .csv or .parquet, which says how it is written.")
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise SweepError(f"--out {path}: give a file in a folder that exists.")
    if path.suffix == ".parquet":
        _pyarrow()


def write_table(path: Path, rows: Rows) -> None:
    """Write rows as the end of the name says; what some rows lack is empty in them."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    beside = path.with_name(f".{path.name}.part")
    WRITERS[path.suffix](beside, names, rows)
    beside.replace(path)


def _write_csv(path: Path, names: Sequence[str], rows: Rows) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows([_text(row.get(name)) for name in names] for row in rows)


def _text(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value


def _write_parquet(path: Path, names: Sequence[str], rows: Rows) -> None:
    arrow = _pyarrow()
    import pyarrow.parquet

    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    pyarrow.parquet.write_table(arrow.table(columns), path)


def _column(values: list[Any]) -> list[Any]:
    """Return values that have one type: texts, where a swept key takes values of several."""
    kinds = {type(value) for value in values if value is not None} - {int, float}
    mixed = len(kinds) > 1 or (
        kinds and any(isinstance(value, int | float) for value in values if type(value) not in kinds)
    )
    nested = any(isinstance(each, list | dict) for value in values if isinstance(value, list) for each in value)
    if mixed or nested or dict in kinds:
        return [
            None if value is None else value if isinstance(value, str) else json.dumps(value) for value in values
        ]
    return values


def _pyarrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        raise SweepError(
            "Parquet needs the package pyarrow: pip install 'rtagent[sweeps]'; or write .csv."
        ) from None
    return pyarrow


WRITERS: Mapping[str, Callable[[Path, Sequence[str], Rows], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
}
