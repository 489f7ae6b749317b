"""Saves what can be read of a recording that was cut off or damaged."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from rtagent.telemetry.connection import TelemetryError
from rtagent.telemetry.reading import Damage, Scan
from rtagent.telemetry.recording import McapFile
from rtagent.telemetry.records import STREAMS


class Recovered(NamedTuple):
    """What was saved: how many records, over which time (ns); and what was not."""

    records: int
    duration: int
    damage: Damage


def recover(path: str | Path, target: str | Path) -> Recovered:
    """Write what can be read to `target`, a new file; raise `TelemetryError`."""
    scan, count, times = Scan(path), 0, list[int]()
    try:
        with Path(target).open("xb") as file:
            saved = McapFile(file)
            for entry in scan:
                if entry.stream in STREAMS:
                    saved.add(*entry)
                    count += 1
                    times = [min(*times[:1], entry.time, entry.time), max(*times[1:], entry.time, entry.time)]
            saved.finish()
    except OSError as error:
        raise TelemetryError(
            f"{target} cannot be written: {error.strerror}. Give another file with --to."
        ) from None
    return Recovered(count, times[1] - times[0] if times else 0, scan.damage)
