"""The side of who starts an emulator: a process that begins when it is needed, and ends with its owner."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import weakref
from collections.abc import Sequence
from pathlib import Path
from tempfile import gettempdir
from typing import Any
from uuid import uuid4

from rtagent.errors import DeviceError

LINGER = "2s"
"""So long an emulator outlives a process that died: long enough to be made safe from outside."""


class Emulation:
    """An emulator in a process of its own; it begins when it is needed, and ends with this object.

    `module` is run with `arguments`, and with those that name its `link` and end it when its owner is gone.
    """

    def __init__(self, module: str, arguments: Sequence[str]) -> None:
        self.link = Path(gettempdir()) / f"rtagent-{uuid4().hex}"
        self._command = [sys.executable, "-m", module, *arguments]
        self._command += ["--link", str(self.link), "--linger", LINGER]
        self._process: subprocess.Popen[str] | None = None

    async def begin(self) -> None:
        """Begin it, unless it runs; raise `DeviceError` with what it says where it ends at once."""
        if self._process is None:
            self._process = await asyncio.to_thread(_started, self._command)
            weakref.finalize(self, _end, self._process)

    def tell(self, **order: Any) -> None:
        """Give it an order (see `rtagent emulate NAME --help`); raise `DeviceError` unless it runs."""
        if self._process is None or self._process.stdin is None:
            raise DeviceError("the emulator does not run yet: open the device first.")
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()


def _started(command: Sequence[str]) -> subprocess.Popen[str]:
    """Return the emulator's process once its link is there."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(  # noqa: S603  # our own module, with our own Python
        command,
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
        start_new_session=True,  # Ctrl-C is not for it
    )
    assert process.stdout is not None, "it was asked for"
    if not process.stdout.readline():
        _, said = process.communicate()
        raise DeviceError(f"the emulator did not begin: {said.strip()}")
    return process


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    process.communicate()
