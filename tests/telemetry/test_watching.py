"""What those who watch see: each record once, what was missed, rates, and words for every stream."""

from __future__ import annotations

import msgspec
import pytest
from collecting import assembled, collected
from hypothesis import given
from hypothesis import strategies as st

from rtagent.telemetry import records
from rtagent.telemetry.records import STREAM_OF, Record
from rtagent.telemetry.subscribe import Message, Reader
from rtagent.telemetry.watching import WORDS, Watched, in_words


def event(number: int) -> records.Event:
    return records.Event(sequence=number, time_ns=number, name="annotation", text="here")


@given(st.lists(st.integers(0, 30), max_size=40))
def test_a_reader_gives_each_record_once_in_order_and_counts_the_rest(numbers: list[int]) -> None:
    reader = Reader()
    found = [reader.read("rtagent/a/b/event", msgspec.json.encode(event(number))) for number in numbers]
    seen = [message.record.sequence for message in found if message is not None]
    assert seen == sorted(set(seen))
    missed = sum(message.missed for message in found if message is not None)
    if seen:
        assert missed == seen[-1] - seen[0] + 1 - len(seen)
        assert seen[0] == numbers[0]


def test_streams_of_another_version_are_left_out() -> None:
    assert Reader().read("rtagent/a/b/tomorrow", b"{}") is None


def test_there_are_words_for_every_stream() -> None:
    found = collected(assembled())[0]
    for kind in WORDS:
        for record in found.get(STREAM_OF[kind], [])[:3]:
            assert in_words(record), kind
    assert "move" in in_words(found["action"][0])
    assert in_words(event(3)) == "annotation: here"


@pytest.mark.parametrize("rate", [10, 1000])
def test_rates_are_those_of_the_last_seconds(rate: int) -> None:
    watched, rows = Watched(), []
    for step in range(1, 41):
        for number in range((step - 1) * rate // 10, step * rate // 10):
            watched.take(Message("a", "b", "event", event(number), 2 if number == 7 else 0))
        rows = list(watched.rows(step / 10))
    (row,) = rows
    assert row.rate == pytest.approx(rate, rel=0.1)
    assert (row.records, row.missed) == (4 * rate, 2)


def test_how_a_run_ended_is_said() -> None:
    watched = Watched()
    about: dict[str, object] = {
        "agent": "a", "run": "b", "epoch_ns": 0, "clock": "real", "seed": 1, "scenario": {}, "machine": {},
        "versions": {}, "devices": {}, "state": [], "actions": [], "demons": [], "buttons": [], "control": False,
    }  # fmt: skip
    for ended, said in (("", "goes on"), ("stopped by person", "ended: stopped by person")):
        record: Record = records.Run(sequence=0, time_ns=0, ended=ended, **about)  # type: ignore[arg-type]
        watched.take(Message("a", "b", "run", record, 0))
        assert said in watched.state()
