"""Ends of all kinds: of runs, of those who watch them, and of their senders."""

from __future__ import annotations

import asyncio
import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from collecting import HORDE
from zenoh_runs import access, connected, living, running, until

from rtagent.telemetry.connection import Access
from rtagent.telemetry.reading import Scan, read, read_run
from rtagent.telemetry.records import Observation
from rtagent.telemetry.recovering import recover
from rtagent.telemetry.subscribe import subscribe

pytestmark = pytest.mark.slow

LISTENS = """
import asyncio, sys
from rtagent import subscribe
from rtagent.telemetry.connection import Access

async def main():
    async for message in subscribe(access=Access(endpoint=sys.argv[1])):
        print("got one", flush=True)
        {then}

asyncio.run(main())
"""


@contextlib.contextmanager
def listening(there: Access, then: str) -> Iterator[subprocess.Popen[str]]:
    """Have a program listen that has got one record, and then does what is said."""
    command = [sys.executable, "-c", LISTENS.format(then=then), there.endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "got one\n"
        yield process
        process.kill()


def test_a_program_that_listens_ends_when_it_raises_or_is_interrupted() -> None:
    there = access()
    with running(there):
        with listening(there, "raise ValueError('enough')") as raises:
            assert raises.wait(10) == 1
        with listening(there, "pass") as interrupted:
            interrupted.send_signal(signal.SIGINT)
            assert interrupted.wait(10) != 0


def test_a_listener_that_stands_still_costs_the_others_nothing() -> None:
    there, missed = access(), list[int]()

    async def listen() -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(3), contextlib.aclosing(subscribe(access=there)) as messages:
                async for message in messages:
                    missed.append(message.missed)

    with running(there, "schedule.learn_delay=0", "schedule.period=2ms"), listening(there, "pass") as stopped:
        stopped.send_signal(signal.SIGSTOP)
        asyncio.run(listen())
    assert len(missed) > 500
    assert sum(missed) == 0


def test_the_recording_of_a_run_that_is_killed_is_complete(tmp_path: Path) -> None:
    there, path = access(), tmp_path / "killed.mcap"
    with connected(there) as session, running(there, scenario=HORDE, record=path) as process:
        until(lambda: living(session), "the run")
        time.sleep(0.5)
        moment = time.monotonic_ns()
        process.kill()
        process.wait(10)
        until(lambda: not living(session), "the end of its sender")
    until(lambda: _is_whole(path), "the end of its recording")
    observed = [record for _, record in read(path) if isinstance(record, Observation)]
    assert [record.sequence for record in observed] == list(range(len(observed)))
    assert moment - observed[-1].time_ns < 1e9
    assert read_run(path).ended == ""


def _is_whole(path: Path) -> bool:
    scan = Scan(path)
    for _ in scan:
        pass
    return not scan.damage.cut


@pytest.mark.parametrize("seed", range(3))
def test_of_a_run_that_is_killed_with_its_sender_a_second_is_missing_at_most(tmp_path: Path, seed: int) -> None:
    there, path = access(), tmp_path / "killed.mcap"
    with connected(there) as session, running(there, scenario=HORDE, record=path) as process:
        until(lambda: living(session), "the run")
        time.sleep(random.Random(seed).uniform(0.5, 1.5))
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        moment = time.monotonic_ns()
        for each in (process.pid, *map(int, children)):
            with contextlib.suppress(ProcessLookupError):
                os.kill(each, signal.SIGKILL)
        process.wait(10)
    saved = recover(path, tmp_path / "saved.mcap")
    assert saved.damage.cut
    observed = [record for _, record in read(tmp_path / "saved.mcap") if isinstance(record, Observation)]
    assert [record.sequence for record in observed] == list(range(len(observed)))
    assert moment - observed[-1].time_ns < 1e9


def test_interrupted_a_run_is_gone_at_once_whoever_watches(tmp_path: Path) -> None:
    there, path = access(), tmp_path / "run.mcap"
    with running(there, record=path) as process, listening(there, "pass") as stopped:
        stopped.send_signal(signal.SIGSTOP)
        start = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 1
        assert time.monotonic() - start < 10, "something hangs"
        assert process.stderr is not None
        assert "All devices were made safe" in process.stderr.read()
    assert read_run(path).ended == "stopped by signal: SIGINT"
