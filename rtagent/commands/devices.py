"""`rtagent devices`: what is plugged in, what answers there, and what would cure what is wrong with it."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace

from rich.console import Console
from serial.tools.list_ports import comports

from rtagent import clock, plugins
from rtagent.commands.telling import tell
from rtagent.errors import PluginError, RtagentError
from rtagent.finding import Finding, Probe, Search

NO_PORT = Finding(
    "ports",
    "none",
    "no USB serial port is plugged in.",
    "plug the adapter in; a port that is no USB one can be named: rtagent devices --port PATH.",
)


def devices_command(arguments: argparse.Namespace) -> int:
    """Print what is found at each port; return 0, or 1 where something essential is wrong."""
    search = Search(mend=arguments.mend)
    if arguments.ids:
        search = replace(search, ids=arguments.ids)
    if arguments.bauds:
        search = replace(search, bauds=arguments.bauds)
    found = clock.run(_look(arguments.port, search))
    if arguments.json:
        listed = {port: [asdict(finding) for finding in findings] for port, findings in found.items()}
        sys.stdout.write(json.dumps(listed, indent=2) + "\n")
    else:
        _print(found)
    return int(any(map(_is_broken, found.values())))


def ids(text: str) -> Sequence[int]:
    """Return the ids that `text` means, such as 1-5,9."""
    if not re.fullmatch(r"\d+(-\d+)?(,\d+(-\d+)?)*", text):
        raise argparse.ArgumentTypeError(f"{text!r} names no ids: write 1-5,9")
    ends = [part.split("-") for part in text.split(",")]
    return [number for each in ends for number in range(int(each[0]), int(each[-1]) + 1)]


def bauds(text: str) -> Sequence[int]:
    """Return the rates (bit/s) that `text` means, such as 1000000,57600."""
    if not re.fullmatch(r"[1-9]\d*(,[1-9]\d*)*", text):
        raise argparse.ArgumentTypeError(f"{text!r} are no rates: write 1000000,57600")
    return [int(part) for part in text.split(",")]


async def _look(named: Sequence[str], search: Search) -> dict[str, list[Finding]]:
    """Return what the probes find, by port: at those that were named, else at all USB ports."""
    ports = named or sorted(str(port.device) for port in comports() if port.vid is not None)
    found: dict[str, list[Finding]] = {port: [] for port in ports}
    for port in ports:
        for name in plugins.names("probes"):
            found[port] += await _probe(name, port, replace(search, named=bool(named)))
            if _is_broken(found[port]):
                break  # nothing that is asked of such a port is answered
    return found or {"": [NO_PORT]}


def _is_broken(found: Sequence[Finding]) -> bool:
    return any(finding.essential and finding.problem for finding in found)


async def _probe(name: str, port: str, search: Search) -> Sequence[Finding]:
    """Return what one probe finds; one that fails hides nothing of the others."""
    try:
        probe: Probe = plugins.load("probes", name)
        return await probe(port, search)
    except PluginError as error:
        return [Finding(name, "unknown", str(error), "install that package again.")]
    except (RtagentError, OSError) as error:
        problem, _, cure = str(error).partition(": ")
        return [Finding(name, "not looked for", f"{problem}.", cure or "none is known.", essential=search.named)]


def _print(found: dict[str, list[Finding]]) -> None:
    console = Console(file=sys.stdout, highlight=False, soft_wrap=True)
    for lines in _spaced(found):
        tell(console, lines)
        console.print()


def _spaced(found: dict[str, list[Finding]]) -> Iterator[list[Finding]]:
    for port, findings in found.items():
        yield [Finding(port, ""), *findings] if port else findings
