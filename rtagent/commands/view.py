"""`rtagent view`: a page that shows what goes on in runs."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import webbrowser

from rtagent.commands.access import access
from rtagent.errors import RtagentError
from rtagent.telemetry.subscribe import Access
from rtagent.view.commands import asking
from rtagent.view.runs import Runs
from rtagent.view.server import HOST, Page


def view_command(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C; return 0, or 2 where there is no connection, or the port is taken."""
    try:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_view(access(arguments), arguments))
    except RtagentError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except OSError as error:
        sys.stderr.write(f"--port {arguments.port}: {error.strerror or error}. Give another, or 0 for any.\n")
        return 2
    return 0


async def _view(access: Access, arguments: argparse.Namespace) -> None:
    runs = Runs()
    async with Page(runs, asking(access)).serving(arguments.port) as port:
        address = f"http://{HOST}:{port}"
        sys.stdout.write(f"The view is at {address} (Ctrl-C ends it).\n")
        sys.stdout.flush()
        if arguments.open:
            webbrowser.open(address)
        await runs.feed(arguments.run, access)
