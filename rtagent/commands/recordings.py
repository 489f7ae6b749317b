"""`rtagent info`, `rtagent export` and `rtagent recover`: what becomes of recordings."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from rtagent.errors import RtagentError
from rtagent.telemetry.reading import Scan, read_run
from rtagent.telemetry.records import STREAMS, Fault, Run
from rtagent.units import describe


def info_command(arguments: argparse.Namespace) -> int:
    """Say what is in a recording; return 0, 1 where it was cut off, or 2 where it is none."""
    return _told(lambda: _info(arguments))


def export_command(arguments: argparse.Namespace) -> int:
    """Write a recording as tables; return 0, or 2 where that cannot be."""
    return _told(lambda: _export(arguments))


def recover_command(arguments: argparse.Namespace) -> int:
    """Save what can be read of a recording; return 0, 1 where that is nothing, or 2 where it is none."""
    return _told(lambda: _recover(arguments))


def _told(command: Callable[[], int]) -> int:
    try:
        return command()
    except RtagentError as error:
        sys.stderr.write(f"{error}\n")
        return 2


@dataclass
class Contents:
    """What was counted in a recording; `missing` are gaps in the numbers of a stream."""

    counts: dict[str, int] = field(default_factory=dict)
    missing: dict[str, int] = field(default_factory=dict)
    began_ns: int = 0
    ended_ns: int = 0
    cut_off: bool = False
    damaged_chunks: int = 0
    faults: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, path: str) -> Contents:
        """Count what is there."""
        found, scan = cls(), Scan(path)
        for entry in scan:
            seen = found.counts.get(entry.stream, 0)
            found.counts[entry.stream] = seen + 1
            found.missing[entry.stream] = entry.sequence + 1 - found.counts[entry.stream]
            if entry.stream != "run":
                found.began_ns = min(found.began_ns or entry.time, entry.time)
                found.ended_ns = max(found.ended_ns, entry.time)
            if entry.stream == "fault" and isinstance(fault := entry.record(), Fault):
                found.faults.append(f"{fault.source}: {fault.message}")
        found.cut_off, found.damaged_chunks = scan.damage.cut, scan.damage.chunks
        return found


def _info(arguments: argparse.Namespace) -> int:
    run, found = read_run(arguments.recording), Contents.of(arguments.recording)
    if arguments.json:
        about = {
            name: getattr(run, name) for name in ("agent", "run", "clock", "seed", "ended", "versions", "machine")
        }
        sys.stdout.write(json.dumps(about | asdict(found) | {"scenario": run.scenario}, indent=2) + "\n")
    else:
        _print(run, found, arguments.recording)
    return 1 if found.cut_off or found.damaged_chunks else 0


def _print(run: Run, found: Contents, path: str) -> None:
    lines = [
        f"{run.agent}, run {run.run}: {run.clock} clock, seed {run.seed}",
        f"lasted {describe(found.ended_ns - found.began_ns)}; ended: {run.ended or 'that was not recorded'}",
        f"rtagent {run.versions.get('rtagent')}, python {run.machine.get('python')}, {run.machine.get('system')}",
    ]
    for stream in STREAMS:
        if stream in found.counts:
            missing = f", {found.missing[stream]:,} missing" if found.missing[stream] else ""
            lines.append(f"  {stream:<12} {found.counts[stream]:>10,}{missing}")
    lines += [f"fault: {fault}" for fault in found.faults]
    if found.cut_off or found.damaged_chunks:
        lines.append(f"It was cut off or damaged: `rtagent recover {path}` saves what can be read.")
    sys.stdout.write("\n".join([*lines, ""]))


def _export(arguments: argparse.Namespace) -> int:
    from rtagent.telemetry.tables import Tables

    tables = Tables(arguments.recording)
    source = Path(arguments.recording)
    target = Path(
        arguments.out or (source.with_suffix("") if arguments.to == "csv" else source.with_suffix(".npz"))
    )
    try:
        if arguments.to == "csv":
            written = tables.write_csv(target)
            sys.stdout.write("".join(f"{path}\n" for path in written))
        else:
            tables.write_npz(target)
            sys.stdout.write(f"{target}\n")
    except OSError as error:
        sys.stderr.write(f"{target}: {error.strerror}: give another name with --out.\n")
        return 2
    return 0


def _recover(arguments: argparse.Namespace) -> int:
    from rtagent.telemetry.recovering import recover

    source = Path(arguments.recording)
    target = Path(arguments.to or source.with_name(f"{source.stem}.recovered{source.suffix}"))
    saved = recover(source, target)
    lost = f", {saved.damage.chunks} damaged chunks left out" if saved.damage.chunks else ""
    end = "its end was missing" if saved.damage.cut else "its end was there"
    sys.stdout.write(f"{target}: {saved.records:,} records over {describe(saved.duration)}; {end}{lost}.\n")
    return 0 if saved.records else 1
