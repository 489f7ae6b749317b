"""What a viewer asks a run to do: stop, remember something, press a button."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from rtagent.telemetry.connection import Access, TelemetryError, open_client
from rtagent.telemetry.control import command
from rtagent.telemetry.keys import Place, as_chunk

COMMANDS = ("stop", "annotate", "press")

Ask = Callable[[str, str, str], Awaitable[str]]
"""Takes a run (agent/run), a command and its text; returns what was done, or raises `TelemetryError`."""


def asking(access: Access) -> Ask:
    """Return what passes commands on, as `access` says."""

    async def ask(run: str, name: str, text: str) -> str:
        return await asyncio.to_thread(_ask, access, run, name, text)

    return ask


def _ask(access: Access, run: str, name: str, text: str) -> str:
    place = Place(*run.partition("/")[::2])
    if name not in COMMANDS or any(as_chunk(part) != part for part in place):
        raise TelemetryError(f"{name!r} for the run {run!r}: give stop, annotate or press, and a run as agent/run.")
    with open_client(access) as session:
        return command(session, place, name, text)
