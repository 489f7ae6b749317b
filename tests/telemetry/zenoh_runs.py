"""Runs with a router of their own, and what listens to them."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from parts import SCENARIOS

from rtagent.telemetry.connection import Access, open_client

PATIENCE = 20.0


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def access() -> Access:
    return Access(endpoint=f"tcp/127.0.0.1:{free_port()}")


@contextlib.contextmanager
def running(
    there: Access,
    *settings: str,
    scenario: Path = SCENARIOS / "stopping.toml",
    record: Path | None = None,
    cwd: Path | None = None,
) -> Iterator[subprocess.Popen[str]]:
    """Have a run of many episodes go on, published at the endpoint; in the end it is interrupted."""
    given = [f"telemetry.endpoint={there.endpoint}", "run.episodes=1000", "schedule.learn_delay=2ms", *settings]
    command = [sys.executable, "-m", "rtagent", "run", str(scenario), "--quiet"]
    command += [part for setting in given for part in ("--set", setting)]
    command += ["--record", str(record)] if record else []
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=cwd)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.wait(PATIENCE)
        if process.stderr is not None:
            process.stderr.close()


def until(holds: Callable[[], Any], what: str) -> Any:
    """Wait until something holds, and return it."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        found = holds()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"waited in vain for {what}")


@contextlib.contextmanager
def connected(there: Access) -> Iterator[Any]:
    session = open_client(there)
    try:
        yield session
    finally:
        session.close()


def living(session: Any) -> list[str]:
    """Return the keys of the runs that live."""
    return [str(reply.ok.key_expr) for reply in session.liveliness().get("rtagent/**") if reply.ok is not None]


def answers(session: Any, selector: str) -> dict[str, bytes]:
    """Return what queryables answer, by key."""
    replies: Sequence[Any] = list(session.get(selector))
    return {str(reply.ok.key_expr): reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None}
