"""`rtagent calibrate`: a person moves a limp device by hand, and a file keeps where its zero and its ends are."""

from __future__ import annotations

import argparse
import asyncio
import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live as LiveDisplay
from rich.table import Table

from rtagent import clock, plugins
from rtagent.calibrating import Calibration, Live
from rtagent.errors import RtagentError, ScenarioError, SpecError
from rtagent.scenario import load_devices

if TYPE_CHECKING:
    from rtagent.scenario.load import Part

LOOKS = 0.1
"""Seconds between one look at what is live and the next."""


def calibrate_command(arguments: argparse.Namespace) -> int:
    """Calibrate a device of a scenario; return 0 when it was, 1 where that failed, 2 where it cannot be."""
    try:
        part = _device(arguments)
    except ScenarioError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    calibration: Calibration = plugins.load("calibrations", part.name)
    try:
        sys.stdout.write(f"{clock.run(_calibrate(calibration, part))}\n")
    except (RtagentError, KeyboardInterrupt) as error:
        sys.stderr.write(f"{error or 'interrupted'}\nNothing was written.\n")
        return 1
    return 0


def _device(arguments: argparse.Namespace) -> Part:
    """Return the device that is meant; raise `ScenarioError`."""
    parts, problems = load_devices(arguments.scenario, arguments.set)
    known = plugins.names("calibrations")
    able = {str(part.path[-1]): part for part in parts if part.name in known}
    if arguments.device is not None:
        able = {name: part for name, part in able.items() if name == arguments.device}
    if len(able) == 1:
        return next(iter(able.values()))
    if able:
        raise ScenarioError([f"name the device to calibrate: --device {' or '.join(able)}."])
    there = ", ".join(str(part.path[-1]) for part in parts) or "no device"
    drivers = " or ".join(known) or "no driver"
    raise ScenarioError(
        [*problems, f"{arguments.scenario} has {there}: there is nothing to calibrate; {drivers} can be."]
    )


async def _calibrate(calibration: Calibration, part: Part) -> str:
    person = Terminal(Console())
    try:
        return await calibration(person, **part.given())
    finally:
        person.close()


class Terminal:
    """A person at a terminal, who ends each step with Enter."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lines: asyncio.Queue[str] = asyncio.Queue()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(sys.stdin, self._hear)

    async def does(self, instruction: str, live: Live) -> None:
        """Show an instruction and a table of what is live, until Enter."""
        self._console.print(f"[bold]{instruction}[/bold] Then press Enter.")
        entered = asyncio.ensure_future(self._lines.get())
        with LiveDisplay(_table(live), console=self._console, auto_refresh=False) as display:
            while not entered.done():
                await asyncio.wait({entered}, timeout=LOOKS)
                display.update(_table(live), refresh=True)
        if not entered.result():
            raise SpecError("nobody is there to calibrate: run it where somebody can press Enter.")

    def close(self) -> None:
        """Listen no more."""
        self._loop.remove_reader(sys.stdin)

    def _hear(self) -> None:
        line = sys.stdin.readline()
        self._lines.put_nowait(line)
        if not line:
            self.close()


def _table(live: Live) -> Table:
    table = Table.grid(padding=(0, 2))
    for name, value in live().items():
        table.add_row(name, value)
    return table
