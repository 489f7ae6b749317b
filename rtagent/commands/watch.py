"""`rtagent watch`: what goes on in runs, as a table on the terminal."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from rtagent.commands.access import access
from rtagent.errors import RtagentError
from rtagent.telemetry.subscribe import Access, subscribe
from rtagent.telemetry.watching import Watched

EVERY = 0.25
"""So often (s) the table is drawn."""
LEAST, TAKEN = 20, 48
"""How wide, in columns, what is newest is at least, and all else."""
ONCE = 1.5
"""How long (s) is listened before what is known is printed once."""


def watch_command(arguments: argparse.Namespace) -> int:
    """Show runs until Ctrl-C; return 0, or 2 where there is no connection."""
    try:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_watch(arguments.run, access(arguments), once=arguments.once))
    except RtagentError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


async def _watch(agent: str, access: Access, *, once: bool) -> None:
    runs: dict[tuple[str, str], Watched] = {}
    console = Console()
    connected = asyncio.get_running_loop().create_future()
    listening = asyncio.ensure_future(_listen(agent, access, runs, connected))
    try:
        if once:
            await asyncio.wait({listening, connected}, return_when=asyncio.FIRST_COMPLETED)
            for _ in range(2):  # a rate is between two looks
                _drawn(runs, console.width)
                await asyncio.wait({listening}, timeout=ONCE / 2)
            if not listening.done():
                console.print(_drawn(runs, console.width))
        else:
            await _draw(console, runs, listening)
    finally:
        if listening.done():
            listening.result()
        else:
            listening.cancel()
            await asyncio.wait({listening})


async def _draw(console: Console, runs: dict[tuple[str, str], Watched], listening: asyncio.Future[None]) -> None:
    with Live(_drawn(runs, console.width), console=console, auto_refresh=False, screen=console.is_terminal) as live:
        while not listening.done():
            await asyncio.wait({listening}, timeout=EVERY)
            live.update(_drawn(runs, console.width), refresh=True)


async def _listen(
    agent: str, access: Access, runs: dict[tuple[str, str], Watched], connected: asyncio.Future[None]
) -> None:
    listener = subscribe(agent, access=access, connected=lambda: connected.set_result(None))
    async with contextlib.aclosing(listener) as messages:
        async for message in messages:
            runs.setdefault((message.agent, message.run), Watched()).take(message)


def _drawn(runs: dict[tuple[str, str], Watched], width: int) -> Group:
    if not runs:
        return Group(Text("No run is published here. Start one: rtagent run scenarios/stopping.toml"))
    now = asyncio.get_running_loop().time()
    return Group(*(_table(agent, run, watched, now, width) for (agent, run), watched in runs.items()))


def _table(agent: str, run: str, watched: Watched, now: float, width: int) -> Table:
    table = Table(title=f"{agent}  {run}  {watched.state()}", title_justify="left", box=None, padding=(0, 2, 0, 0))
    table.add_column("stream", width=11)
    for name in ("a second", "all", "missed"):
        table.add_column(name, justify="right", width=9)
    table.add_column("newest", no_wrap=True, overflow="ellipsis", width=max(LEAST, width - TAKEN))
    for row in watched.rows(now):
        table.add_row(row.stream, f"{row.rate:,.0f}", f"{row.records:,}", f"{row.missed:,}", Text(row.newest))
    return table
