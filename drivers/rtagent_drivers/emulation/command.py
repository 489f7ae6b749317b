"""What the commands of emulators share: options, a log, and how they end."""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

from rtagent.errors import RtagentError
from rtagent.units import TIME

Log = Callable[[Mapping[str, Any]], object]
"""Takes what happened, as JSON can hold it."""


def emulate(given: argparse.Namespace, run: Callable[[argparse.Namespace], None]) -> int:
    """Run an emulator until a signal comes; return its exit code."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, _end)
    try:
        with contextlib.suppress(SystemExit):
            run(given)
    except (RtagentError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what every emulator can be told."""
    parser.add_argument("--link", type=Path, required=True, help="the name under which programs find it")
    parser.add_argument("--log", type=Path, metavar="FILE", help="what happens goes there, a JSON object a line")
    parser.add_argument("--fault", action="append", default=[], metavar="JSON", help="may be repeated")
    parser.add_argument("--linger", type=TIME.parse, help="end so long after the standard input has ended")


@contextlib.contextmanager
def log_to(path: Path | None) -> Iterator[Log | None]:
    """Give what writes to the log, a line at a time, so that it can be read meanwhile."""
    if path is None:
        yield None
        return
    with path.open("a", buffering=1, encoding="utf-8") as file:
        write: Callable[[str], Any] = file.write
        yield lambda what: write(json.dumps(what) + "\n")


def say(line: str) -> None:
    """Print a line at once: whoever started it may wait for it."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)
