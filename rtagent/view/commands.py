"""What a viewer asks a run to do: stop, remember something, press a button."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from rtagent.telemetry.connection import Access, TelemetryError, open_client
from rtagent.telemetry.keys import Place

COMMANDS = ("stop", "annotate", "press")
PATIENCE = 2.0
"""How long (s) is waited for an answer."""

Ask = Callable[[str, str, str], Awaitable[str]]
"""Takes a run, a command and its text; returns what was done, or raises `TelemetryError`."""


def asking(access: Access) -> Ask:
    """Return what passes commands on, as `access` says."""

    async def ask(run: str, name: str, text: str) -> str:
        return await asyncio.to_thread(command, access, run, name, text)

    return ask


def command(access: Access, run: str, name: str, text: str) -> str:
    """Ask a run (agent/run) to do something; return what it answers. Raises `TelemetryError`."""
    agent, _, run_id = run.partition("/")
    if name not in COMMANDS or not agent or not run_id or set("*$?#/") & set(agent + run_id):
        raise TelemetryError(f"{name!r} for the run {run!r}: give stop, annotate or press, and a run as agent/run.")
    with open_client(access, start_router=False) as session:
        for reply in session.get(Place(agent, run_id).control(name), payload=text, timeout=PATIENCE):
            if reply.ok is not None:
                return str(reply.ok.payload.to_string())
            raise TelemetryError(
                reply.err.payload.to_string() if reply.err is not None else "the run said nothing."
            )
    raise TelemetryError(
        f"the run {run} does not answer: it has ended, or its scenario has no control = true under [telemetry]."
    )
