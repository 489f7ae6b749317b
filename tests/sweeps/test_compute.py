"""Measuring cells: nothing lost, nothing twice, whatever happens to the process, its file and its workers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import measuring
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measuring import asked, choosy, deadly, not_plain, squared, threads

from rtagent.errors import SweepError
from rtagent.sweeps import store as stores
from rtagent.sweeps.compute import Finished, MeasuringError, compute
from rtagent.sweeps.store import Store, key_of
from rtagent.sweeps.workers import WATCHING

HERE = Path(__file__).parent


def cells(folder: Path, count: int) -> list[dict[str, Any]]:
    return [{"number": number, "asked": str(folder / "asked")} for number in range(count)]


def squares(count: int) -> list[dict[str, int]]:
    return [{"square": number**2} for number in range(count)]


def test_rows_come_in_the_order_of_the_cells_and_only_once(tmp_path: Path) -> None:
    told: list[Finished] = []
    again: list[Finished] = []
    first = compute(squared, cells(tmp_path, 5), store=tmp_path / "store", finished=told.append)
    second = compute(squared, cells(tmp_path, 7)[::-1], store=tmp_path / "store", finished=again.append)
    assert first == squares(5)
    assert second == squares(7)[::-1]
    assert asked(tmp_path / "asked") == [0, 1, 2, 3, 4, 6, 5]
    assert [each.kept for each in told] == [False] * 5
    assert sorted(each.kept for each in again) == [False] * 2 + [True] * 5


def test_the_same_cell_twice_is_measured_once(tmp_path: Path) -> None:
    twice = cells(tmp_path, 2) * 2
    assert compute(squared, twice) == squares(2) * 2
    assert asked(tmp_path / "asked") == [0, 1]


def test_another_function_version_or_cell_has_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = [key_of(squared, {"a": 1, "b": 2}), key_of(squared, {"a": 1, "b": 3}), key_of(choosy, {"a": 1, "b": 2})]
    assert key_of(squared, {"b": 2, "a": 1}) == keys[0]
    monkeypatch.setattr(stores, "__version__", "99")
    assert len({*keys, key_of(squared, {"a": 1, "b": 2})}) == 4


@pytest.mark.slow
@settings(max_examples=30)
@given(cut=st.integers(0, 10_000))
def test_wherever_the_file_is_cut_off_the_rest_is_measured_again(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    path, told = folder / "store", list[str]()
    compute(squared, cells(folder, 4), store=path)
    whole = path.read_bytes()
    ends = [place + 1 for place, byte in enumerate(whole) if byte == ord("\n")]
    cut %= len(whole) + 1
    path.write_bytes(whole[:cut])
    assert compute(squared, cells(folder, 4), store=path, damaged=told.append) == squares(4)
    complete = sum(end <= cut for end in ends)
    assert asked(folder / "asked") == [0, 1, 2, 3, *range(complete, 4)]
    assert bool(told) == (cut not in (0, *ends))
    assert compute(squared, cells(folder, 4), store=path, damaged=pytest.fail) == squares(4)


@pytest.mark.parametrize("line", [0, 2, 3])
def test_a_damaged_entry_is_told_and_measured_again(tmp_path: Path, line: int) -> None:
    path, told = tmp_path / "store", list[str]()
    compute(squared, cells(tmp_path, 4), store=path)
    lines = path.read_bytes().splitlines(keepends=True)
    lines[line] = lines[line].replace(b'"square":', b'"squaro":')
    path.write_bytes(b"".join(lines))
    assert compute(squared, cells(tmp_path, 4), store=path, damaged=told.append) == squares(4)
    assert told == [f"{path}:{line + 1}: this entry is damaged: its cell is measured again."]
    assert asked(tmp_path / "asked") == [0, 1, 2, 3, line]


def test_two_sweeps_do_not_share_a_store(tmp_path: Path) -> None:
    with Store(tmp_path / "store"), pytest.raises(SweepError, match="another sweep is writing there"):
        compute(squared, cells(tmp_path, 1), store=tmp_path / "store")


def test_a_store_that_cannot_be_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path, tmp_path / "file" / "store"):
        with pytest.raises(SweepError, match="nothing can be kept there"):
            compute(squared, [], store=path)


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_cells_that_fail_leave_the_others(tmp_path: Path, jobs: int) -> None:
    with pytest.raises(MeasuringError, match="3 of 9 could not be measured: ValueError: 2 is not for me") as caught:
        compute(choosy, cells(tmp_path, 9), store=tmp_path / "store", jobs=jobs)
    assert sorted(failure.cell["number"] for failure in caught.value.failures) == [2, 5, 8]
    assert "raise ValueError" in caught.value.failures[0].trace
    assert sorted(asked(tmp_path / "asked")) == [0, 1, 3, 4, 6, 7]
    with Store(tmp_path / "store") as kept:
        assert len(kept) == 6


def test_rows_that_are_not_plain_are_refused() -> None:
    with pytest.raises(MeasuringError, match="cells and rows are plain data"):
        compute(not_plain, [{"number": 1}])
    with pytest.raises(SweepError, match="cells and rows are plain data"):
        compute(squared, [{"number": Path()}])


@pytest.mark.slow
def test_processes_find_the_same_and_take_one_thread_each(tmp_path: Path) -> None:
    assert compute(squared, cells(tmp_path, 6), store=tmp_path / "store", jobs=2) == squares(6)
    pids = {line.split()[1] for line in (tmp_path / "asked").read_text().splitlines()}
    assert str(os.getpid()) not in pids
    assert compute(threads, [{"number": 1}, {"number": 2}], jobs=2) == [{"most": 1}] * 2
    assert compute(threads, [{"number": 1}]) == [{"most": 1}]


@pytest.mark.slow
def test_a_worker_that_is_killed_is_told_and_the_others_are_kept(tmp_path: Path) -> None:
    with pytest.raises(SweepError, match="a process that measured was killed"):
        compute(deadly, cells(tmp_path, 6), store=tmp_path / "store", jobs=2)
    done = compute(squared, cells(tmp_path, 6))
    assert done == squares(6)


def started(folder: Path, count: int, seconds: float, jobs: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, measuring.__file__, str(folder), str(count), str(seconds), str(jobs)]
    return subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)


def wait_for(folder: Path, entries: int) -> None:
    path = folder / "store"
    until = time.monotonic() + 30
    while not path.exists() or path.read_bytes().count(b"\n") < entries:
        assert time.monotonic() < until, "nothing is measured"
        time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGKILL, 1), (signal.SIGKILL, 2), (signal.SIGINT, 2)])
def test_a_sweep_that_is_killed_goes_on_where_it_was(tmp_path: Path, number: signal.Signals, jobs: int) -> None:
    sweep = started(tmp_path, 20, 0.1, jobs)
    try:
        wait_for(tmp_path, 6)
        (os.killpg if number == signal.SIGINT else os.kill)(sweep.pid, number)
        assert sweep.wait(30) != 0
    finally:
        sweep.kill()
    time.sleep(2 * WATCHING)
    before = asked(tmp_path / "asked")
    with Store(tmp_path / "store") as kept:
        complete = len(kept)
    assert 6 <= complete < 20
    assert started(tmp_path, 20, 0.1, jobs).wait(60) == 0
    with Store(tmp_path / "store") as kept:
        assert len(kept) == 20
    assert set(asked(tmp_path / "asked")) == set(range(20))
    again = len(asked(tmp_path / "asked")) - 20
    assert again == len(before) - complete <= 2 * jobs, "only what was in progress is measured again"
    assert not survivors(sweep.pid), "nobody is left behind"


def survivors(session: int) -> list[str]:
    """Return what the processes of a session are called."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has just ended
            if os.getsid(int(process.name)) == session:
                found.append((process / "cmdline").read_text())
    return found
