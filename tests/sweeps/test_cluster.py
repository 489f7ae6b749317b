"""A sweep on a real Dask cluster of this machine: two workers, one of which is killed in mid-sweep."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from measuring import asked, squared
from parts import SCENARIOS
from test_sweep_command import rows

from rtagent.__main__ import main
from rtagent.errors import SweepError
from rtagent.sweeps.compute import compute
from rtagent.sweeps.store import Store
from rtagent.sweeps.workers import connected

pytest.importorskip("distributed")

STOPPING = str(SCENARIOS / "stopping.toml")
HERE = Path(__file__).parent


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a program of Dask's that finds the modules of the tests, and end it."""
    environment = os.environ | {"PYTHONPATH": str(HERE)}
    command = [sys.executable, "-m", *arguments]
    started = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


@contextmanager
def cluster(workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    address, nowhere = f"tcp://127.0.0.1:{free_port()}", ("--no-dashboard",)
    scheduler = (
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        address.rsplit(":")[-1],
        *nowhere,
    )
    worker = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", *nowhere)
    with ExitStack() as stack:
        stack.enter_context(process(*scheduler))
        started = [stack.enter_context(process(*worker)) for _ in range(workers)]
        if workers:
            with connected(address) as client:
                client.wait_for_workers(workers, timeout=60)
        yield address, started


@pytest.mark.slow
def test_a_worker_that_is_killed_in_mid_sweep_changes_nothing(tmp_path: Path) -> None:
    cells = [{"number": number, "takes": 0.2, "asked": str(tmp_path / "asked")} for number in range(24)]
    with cluster(2) as (address, workers):
        killed = False

        def kill(finished: object) -> None:
            nonlocal killed
            pids = {line.split()[1] for line in (tmp_path / "asked").read_text().splitlines()}
            if not killed and len(pids) == 2:
                killed = True
                workers[0].kill()

        found = compute(squared, cells, store=tmp_path / "store", cluster=address, finished=kill)
    assert killed, "both took part"
    assert found == compute(squared, [{"number": number} for number in range(24)])
    with Store(tmp_path / "store") as kept:
        assert len(kept) == 24
    assert (tmp_path / "store").read_bytes().count(b"\n") == 24, "nothing is kept twice"
    assert set(asked(tmp_path / "asked")) == set(range(24))
    assert len(asked(tmp_path / "asked")) <= 24 + 1 + 1, "but for what the killed one had done and not yet told"


@pytest.mark.slow
def test_the_command_finds_the_same_on_a_cluster(tmp_path: Path) -> None:
    over = ["--clock", "virtual", "--quiet", "--over", "schedule.preset=standard,reactive", "--trials", "2"]
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    with cluster(2) as (address, _):
        assert main(["sweep", STOPPING, *over, "--out", str(there), "--cluster", address]) == 0
    assert main(["sweep", STOPPING, *over, "--out", str(here), "--jobs", "1"]) == 0
    assert rows(here) == rows(there)


@pytest.mark.slow
def test_a_cluster_that_does_not_answer_or_work_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rtagent.sweeps.workers.CONNECTING", 1)
    with pytest.raises(SweepError, match="no Dask scheduler answers there"):
        compute(squared, [{"number": 1}], cluster=f"tcp://127.0.0.1:{free_port()}")
    with cluster(0) as (address, _):
        until = time.monotonic() + 20
        while True:
            with pytest.raises(SweepError) as caught:
                compute(squared, [{"number": 1}], cluster=address)
            if "has had no worker for 1 s" in str(caught.value):
                break
            assert time.monotonic() < until, "the scheduler is up by now"
