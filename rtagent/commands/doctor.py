"""`rtagent doctor`: what this machine allows, how late it wakes us, and what would cure what is wrong."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.table import Table

from rtagent.commands.findings import findings
from rtagent.commands.telling import tell
from rtagent.finding import Finding
from rtagent.latency import measure
from rtagent.realtime import Realtime, manners
from rtagent.summary import Summary
from rtagent.units import describe, ms

Latencies = Mapping[str, Mapping[str, Summary]]

MEASURED = 800 * ms
"""Each way is watched for so long."""

PRIORITY = 50
LATE = 1 * ms
NAMES = {"sleep": "sleep of 1 ms, late by", "event": "event from another process, after"}
CURE = "end other programs, or ask for manners: [realtime] priority and processors."


def doctor_command(arguments: argparse.Namespace) -> int:
    """Print what is found; return 0, or 1 where something essential is broken."""
    found, latencies = list(findings()), {}
    try:
        latencies = measure(_ways(), MEASURED)
    except OSError as error:  # TimeoutError is one
        found.append(_not_measured(error))
    else:
        found += _verdicts(latencies)
    if arguments.json:
        sys.stdout.write(json.dumps(_as_dict(found, latencies), indent=2) + "\n")
    else:
        _print(found, latencies)
    return int(any(finding.essential and finding.problem for finding in found))


def _ways() -> dict[str, Realtime]:
    """Return the ways to measure: as it is, and with each manner that this machine grants."""
    wanted = {f"priority {PRIORITY}": Realtime(priority=PRIORITY), "uvloop": Realtime(uvloop=True)}
    return {"as it is": Realtime()} | {way: realtime for way, realtime in wanted.items() if _is_granted(realtime)}


def _is_granted(realtime: Realtime) -> bool:
    with manners(realtime) as granted:
        return not granted.refused


def _not_measured(error: OSError) -> Finding:
    found = Finding("latency", "unknown", essential=True)
    return found.but(error, f"it could not be measured: {error!r}.", "look why this Python cannot start another.")


def _verdicts(latencies: Latencies) -> list[Finding]:
    """Return a finding for each kind of waking."""
    problem = "one in a hundred is more than a millisecond late."
    return [
        Finding(f"{kind} latency", f"p99 {describe(summary.p99)}").but(summary.p99 > LATE, problem, CURE)
        for kind, summary in latencies["as it is"].items()
    ]


def _as_dict(found: Sequence[Finding], latencies: Latencies) -> dict[str, Any]:
    return {
        "findings": [asdict(finding) for finding in found],
        "latency": {
            way: {kind: summary.in_seconds() for kind, summary in kinds.items()} for way, kinds in latencies.items()
        },
    }


def _print(found: Sequence[Finding], latencies: Latencies) -> None:
    console = Console(file=sys.stdout, highlight=False, soft_wrap=True)
    tell(console, found)
    if latencies:
        console.print()
        console.print(_table(latencies))


def _table(latencies: Latencies) -> Table:
    table = Table("wake-up", "", "count", "median", "p99", "max", box=None, pad_edge=False)
    for column in table.columns[2:]:
        column.justify = "right"
    for kind, name in NAMES.items():
        for way, kinds in latencies.items():
            summary = kinds[kind]
            times = (summary.median, summary.p99, summary.maximum)
            table.add_row(name, way, str(summary.count), *map(describe, times))
    return table
