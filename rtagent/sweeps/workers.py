"""Where cells are measured: here, in processes of this machine, or on a cluster; one thread for each."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from rtagent import __version__, clock
from rtagent.errors import RtagentError, SweepError
from rtagent.result import RunError
from rtagent.sweeps.store import Cell, Row, plain

CONNECTING = 10
"""So long (s) a scheduler may take to answer, and its workers to be there."""

WATCHING = 0.5
"""So often (s) a process looks whether it is still wanted."""

Measure = Callable[[Cell], Row]
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Measured:
    """What became of the cell at a place: what was found (JSON), in which time (s); or how it failed, and where."""

    place: int
    found: str = ""
    seconds: float = 0.0
    failure: str = ""
    trace: str = ""


def measured(measure: Measure, place: int, cell: Cell, version: str = __version__) -> Measured:
    """Measure one cell, in whatever process this is; a stop of it from outside is an interrupt of all."""
    if version != __version__:
        raise SweepError(f"a worker has rtagent {__version__}, and this is {version}: install the same on both.")
    from threadpoolctl import threadpool_limits

    now = clock.RealClock().now
    with _ONE_AT_A_TIME, threadpool_limits(1):
        began = now()
        try:
            return Measured(place, plain(measure(cell)), (now() - began) / 1e9)
        except Exception as error:  # whatever a measuring function raises must not take other cells with it
            if isinstance(error, RunError) and error.stopped:
                raise KeyboardInterrupt from error
            return Measured(place, "", (now() - began) / 1e9, _sentence(error), traceback.format_exc())


def each(measure: Measure, cells: Sequence[tuple[int, Cell]], jobs: int, cluster: str | None) -> Iterator[Measured]:
    """Measure cells, and yield each when it is done, in whatever order; `jobs` at a time, or all of a cluster's."""
    if cluster is not None:
        yield from _on_cluster(measure, cells, cluster)
    elif jobs > 1 and len(cells) > 1:
        yield from _in_processes(measure, cells, min(jobs, len(cells)))
    else:
        yield from (measured(measure, place, cell) for place, cell in cells)


@cache
def _watch(parent: int) -> None:
    """End this process when its parent has ended, however: a sweep that was killed leaves nobody behind.

    Of a Ctrl-C, which all of them are sent, the parent makes an end.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wait() -> None:
        while os.getppid() == parent:
            threading.Event().wait(WATCHING)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _watched(parent: int, measure: Measure, place: int, cell: Cell) -> Measured:
    _watch(parent)
    return measured(measure, place, cell)


def _in_processes(measure: Measure, cells: Sequence[tuple[int, Cell]], jobs: int) -> Iterator[Measured]:
    from joblib import parallel_config

    with parallel_config("loky", inner_max_num_threads=1), _killed_told():
        yield from _parallel(partial(_watched, os.getpid(), measure), cells, jobs)


def _on_cluster(measure: Measure, cells: Sequence[tuple[int, Cell]], address: str) -> Iterator[Measured]:
    client = connected(address)
    from joblib import parallel_config

    with client, parallel_config("dask", client=client, wait_for_workers_timeout=CONNECTING), _killed_told():
        yield from _parallel(partial(measured, measure, version=__version__), cells, -1)


def _parallel(call: Callable[..., Measured], cells: Sequence[tuple[int, Cell]], jobs: int) -> Iterator[Measured]:
    from joblib import Parallel, delayed

    done = Parallel(jobs, return_as="generator_unordered", batch_size=1)(delayed(call)(*each) for each in cells)
    with contextlib.closing(done):
        yield from done


@contextlib.contextmanager
def _killed_told() -> Iterator[None]:
    """Tell in a sentence what happens to processes that measure."""
    try:
        yield
    except TimeoutError:
        raise SweepError(
            f"the cluster has had no worker for {CONNECTING} s: start some with `dask worker ADDRESS --nthreads 1`."
        ) from None
    except Exception as error:
        if type(error).__name__ not in ("TerminatedWorkerError", "KilledWorker", "BrokenProcessPool"):
            raise
        raise SweepError(
            "a process that measured was killed, perhaps for want of memory: take fewer jobs. What was measured is "
            "kept, and the same command goes on."
        ) from error


def connected(address: str) -> Any:
    """Return a client of the Dask scheduler at an address; raise `SweepError` where there is none."""
    if not re.fullmatch(r"(tcp|tls)://[^/\s]+:\d+", address):
        raise SweepError(f"--cluster {address}: write the scheduler's address as tcp://host:port.")
    try:
        from distributed import Client
    except ImportError:
        raise SweepError("--cluster needs dask and distributed: pip install 'rtagent[sweeps]'.") from None
    try:
        connect: Any = Client  # has no types
        return connect(address, timeout=CONNECTING, set_as_default=False)
    except (OSError, TimeoutError):
        raise SweepError(
            f"--cluster {address}: no Dask scheduler answers there: start one with `dask scheduler`, and workers "
            f"with `dask worker {address} --nthreads 1`."
        ) from None


def _sentence(error: Exception) -> str:
    return str(error) if isinstance(error, RtagentError) else f"{type(error).__name__}: {error}"
