"""What every benchmark shares: rows with a reach, a table of them, `--json` and `--check`."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Literal


@dataclass(frozen=True)
class Row:
    """One figure; `reach` is the limit that it has to keep (None: it is only shown)."""

    name: str
    value: float
    unit: str
    reach: float | None = None
    better: Literal["lower", "higher"] = "lower"

    @property
    def falls_short(self) -> bool:
        """Whether the value is beyond its reach; one that is not a number is."""
        if self.reach is None:
            return False
        return not (self.value <= self.reach if self.better == "lower" else self.value >= self.reach)


Rows = Callable[[], Iterable[Row]]


def main(rows: Rows, description: str | None, arguments: Sequence[str] | None = None) -> int:
    """Measure, print, and return the exit code of the script."""
    options = _parser(description).parse_args(arguments)
    measured = list(rows())
    print(as_json(measured) if options.json else as_table(measured))
    short = [row.name for row in measured if row.falls_short]
    if not (options.check and short):
        return 0
    print(f"short of their reach: {'; '.join(short)}", file=sys.stderr)
    return 1


def as_json(rows: Sequence[Row]) -> str:
    """Return the rows as a JSON array of objects."""
    return json.dumps([asdict(row) | {"falls_short": row.falls_short} for row in rows], indent=2)


def as_table(rows: Sequence[Row]) -> str:
    """Return the rows as an aligned table of plain text."""
    lines = [("", "value", "unit", "reach", "")] + [_cells(row) for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(_aligned(line, widths).rstrip() for line in lines)


def _parser(description: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--check", action="store_true", help="exit with 1 if a row falls short of its reach")
    return parser


def _cells(row: Row) -> tuple[str, ...]:
    sign = "≤" if row.better == "lower" else "≥"
    reach = "" if row.reach is None else f"{sign} {_number(row.reach)}"
    return row.name, _number(row.value), row.unit, reach, "falls short" if row.falls_short else ""


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def _aligned(line: Sequence[str], widths: Sequence[int]) -> str:
    name, value, unit, reach, verdict = line
    return (
        f"{name:<{widths[0]}}  {value:>{widths[1]}} {unit:<{widths[2]}}  "
        f"{reach:<{widths[3]}}  {verdict:<{widths[4]}}"
    )
