"""Recordings: whole, cut off anywhere, damaged, on a disk that is full or stands still."""

from __future__ import annotations

import errno
import io
import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest
from collecting import HORDE
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from parts import SCENARIOS

from rtagent.__main__ import main
from rtagent.telemetry import recording
from rtagent.telemetry.connection import TelemetryError
from rtagent.telemetry.reading import Entry, Scan, read, read_run
from rtagent.telemetry.recording import McapFile, Recorder
from rtagent.telemetry.recovering import recover

ENTRY = b'{"name":"annotation","text":"%d","sequence":%d,"time_ns":%d}'


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a run under the virtual clock, made by the command line."""
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    options = ["--clock", "virtual", "--quiet", "--episodes", "2", "--set", "run.episode_steps=40"]
    assert main(["run", str(HORDE), *options, "--record", str(path)]) == 0
    return path


def test_somebody_elses_reader_finds_all_of_it(recorded: Path) -> None:
    with recorded.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        messages = [
            (channel.topic, message.sequence, message.data) for _, channel, message in reader.iter_messages()
        ]
    assert summary is not None
    assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
    assert sorted(messages) == sorted((each.stream, each.sequence, each.data) for each in Scan(recorded))
    assert sum(topic == "transition" for topic, _, _ in messages) == 80
    assert sum(topic == "prediction" for topic, _, _ in messages) == 78, "of the last that a cycle learned"


def test_it_tells_of_the_run_all_that_is_needed_to_do_it_again(recorded: Path) -> None:
    run = read_run(recorded)
    assert run.scenario["horde"]["demons"][0]["gammas"] == [0.5, 0.8, 0.9, 0.95, 0.99]
    assert (run.seed, run.clock, run.ended, len(run.demons)) == (1, "virtual", "done", 100)
    assert run.versions["numpy"] == np.__version__
    assert run.demons[0].signal in run.state
    assert [stream for stream, _ in read(recorded)].count("episode") == 2


def test_the_result_of_a_run_is_the_same_with_and_without(tmp_path: Path) -> None:
    options = ["run", str(SCENARIOS / "stopping.toml"), "--clock", "virtual", "--quiet", "--json"]
    plain, recorded = tmp_path / "plain.json", tmp_path / "recorded.json"
    assert main([*options, str(plain)]) == 0
    assert main([*options, str(recorded), "--record", str(tmp_path / "run.mcap")]) == 0
    assert plain.read_bytes() == recorded.read_bytes()


class Chunked(NamedTuple):
    """A file, what is in it, and where each of its chunks of five ends."""

    content: bytes
    entries: list[Entry]
    ends: list[int]


@pytest.fixture(scope="module")
def chunked() -> Chunked:
    """A file of many small chunks, without any index at its end."""
    kept, entries, ends = io.BytesIO(), list[Entry](), list[int]()
    file = McapFile(kept)
    for number in range(60):
        entries.append(Entry("event", number, number, ENTRY % (number, number, number)))
        file.add(*entries[-1])
        if number % 5 == 4:
            file.close_chunk()
            ends.append(kept.tell())
    return Chunked(kept.getvalue(), entries, ends)


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_file_cut_off_anywhere_gives_all_whole_chunks(
    chunked: Chunked, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content, entries, ends = chunked
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    length = data.draw(st.integers(8, len(content)))
    path.write_bytes(content[:length])
    scan = Scan(path)
    found = list(scan)
    assert found == entries[: len(found)]
    assert scan.damage.cut
    assert len(found) >= 5 * sum(end <= length for end in ends)
    saved = recover(path, path.with_name("saved.mcap"))
    assert list(Scan(path.with_name("saved.mcap"))) == found
    assert saved.records == len(found)


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_of_a_damaged_file_nothing_wrong_is_read(
    chunked: Chunked, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(chunked.content)
    place, bit = data.draw(st.integers(8, len(content) - 1)), data.draw(st.integers(0, 7))
    content[place] ^= 1 << bit
    path = tmp_path_factory.mktemp("damaged") / "damaged.mcap"
    path.write_bytes(content)
    assert set(Scan(path)) <= set(chunked.entries)


def test_what_is_no_recording_is_refused_with_a_sentence(tmp_path: Path) -> None:
    text = tmp_path / "text.mcap"
    text.write_text("this is no recording")
    for path, said in ((text, "is no MCAP file"), (tmp_path / "absent.mcap", "cannot be read")):
        with pytest.raises(TelemetryError, match=said):
            Scan(path)


# Disks


class FullDisk(io.BytesIO):
    """Has room for so many bytes, but for what `truncate` gives back."""

    room = 20_000

    def write(self, data: Any) -> int:
        if self.tell() + len(data) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)

    def close(self) -> None:
        """Stay readable."""


class StalledDisk(io.BytesIO):
    """Takes nothing until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.goes_on = threading.Event()

    def write(self, data: Any) -> int:
        self.goes_on.wait(20)
        return super().write(data)

    def close(self) -> None:
        """Stay readable."""


def on(disk: Any, monkeypatch: pytest.MonkeyPatch) -> tuple[Recorder, list[str]]:
    troubles: list[str] = []
    monkeypatch.setattr(recording, "open_new", lambda path: disk)
    monkeypatch.setattr(recording, "CLOSE_CHUNK_EVERY", 1_000_000)
    return Recorder("run.mcap", troubles.append), troubles


def add(recorder: Recorder, numbers: Iterator[int], count: int) -> None:
    for number in [next(numbers) for _ in range(count)]:
        recorder.add("event", number, number, ENTRY % (number, number, number))


def test_a_full_disk_is_told_and_what_was_written_stays_readable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    disk, numbers, until = FullDisk(), iter(range(10**6)), time.monotonic() + 20
    recorder, troubles = on(disk, monkeypatch)
    while not troubles and time.monotonic() < until:
        add(recorder, numbers, 20)
        time.sleep(0.002)
    add(recorder, numbers, 5)
    assert recorder.not_recorded >= 5
    assert recorder.close(5)
    assert len(troubles) == 1
    assert "No space left on device" in troubles[0]
    assert "rtagent recover run.mcap" in troubles[0]
    path = tmp_path / "full.mcap"
    path.write_bytes(disk.getvalue())
    found = list(Scan(path))
    assert [entry.sequence for entry in found] == list(range(len(found)))
    assert len(found) > 20


def test_a_disk_that_stands_still_delays_nobody_and_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "PATIENCE", 1_000_000)
    monkeypatch.setattr(recording, "MOST_WAITING", 1000)
    disk, numbers = StalledDisk(), iter(range(10**6))
    recorder, troubles = on(disk, monkeypatch)
    add(recorder, numbers, 100)
    time.sleep(0.01)
    recorder.look()
    recorder.look()
    assert len(troubles) == 1
    assert "its disk takes nothing" in troubles[0]
    assert 0 < recorder.not_recorded < 100
    assert not recorder.close(0.01)
    disk.goes_on.set()
    assert recorder.close(10)
    count = sum(1 for _ in make_reader(io.BytesIO(disk.getvalue())).iter_messages())
    assert count + recorder.not_recorded == 100


# The commands


def test_info_and_export_tell_the_same(recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(recorded), "--json"]) == 0
    about = json.loads(capsys.readouterr().out)
    assert about["counts"]["transition"] == 80
    assert set(about["missing"].values()) == {0}
    assert main(["export", str(recorded), "--to", "npz", "--out", str(tmp_path / "run.npz")]) == 0
    assert main(["export", str(recorded), "--to", "csv", "--out", str(tmp_path / "tables")]) == 0
    with np.load(tmp_path / "run.npz") as arrays:
        rewards = arrays["transition/reward"]
        assert arrays["prediction/time_ns"].dtype == np.int64
        demon = read_run(recorded).demons[7].name
        predictions = [record.values[7] for stream, record in read(recorded) if stream == "prediction"]
        np.testing.assert_array_equal(arrays[f"prediction/values.{demon}"], np.array(predictions, float))
    table = np.genfromtxt(
        tmp_path / "tables" / "transition.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    np.testing.assert_array_equal(table["reward"], rewards)
    assert main(["info", str(recorded)]) == 0
    assert "80" in capsys.readouterr().out


def test_the_commands_write_over_nothing(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = recorded.read_bytes()
    assert main(["run", str(HORDE), "--clock", "virtual", "--record", str(recorded)]) == 2
    assert "would be lost" in capsys.readouterr().err
    assert main(["export", str(recorded), "--to", "npz", "--out", str(recorded)]) == 2
    assert main(["recover", str(recorded), "--to", str(recorded)]) == 2
    assert "give another" in capsys.readouterr().err.lower()
    assert recorded.read_bytes() == before


def test_a_record_of_another_version_is_refused_with_a_sentence() -> None:
    with pytest.raises(TelemetryError, match="not as this version knows it"):
        Entry("sample", 0, 0, msgspec.json.encode({"sequence": 0})).record()
