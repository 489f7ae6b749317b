"""The timeline of a run, as somebody else's reader finds it: by the description of the trace-event format."""

from __future__ import annotations

import gzip
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS, run_stopping

from rtagent import ms
from rtagent.__main__ import main
from rtagent.instruments import NOTED
from rtagent.learn import Learn, Where
from rtagent.result import Result
from rtagent.schedule import ACT, PRESETS
from rtagent.timeline import Timeline, write
from rtagent.timeline.recording import MOST_FAULTS, MOST_LABELS, OTHER, Kind
from rtagent.timeline.rows import Rows
from rtagent.timeline.tracks import Lanes
from rtagent_drivers.fake import Sampling
from rtagent_drivers.stopping import stopping_joint

STOPPING = str(SCENARIOS / "stopping.toml")
NUMBER, NATURAL = {"type": "number", "minimum": 0}, {"type": "integer", "minimum": 0}
COMMON = {"name": {"type": "string"}, "cat": {"type": "string"}, "pid": NATURAL, "tid": NATURAL, "ts": NUMBER}


def phase(letter: str, needs: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "properties": {"ph": {"const": letter}, "args": {"type": "object"}, **COMMON, **needs},
        "required": sorted({"name", "ph", "pid", "tid", "ts", *needs}),
        "additionalProperties": False,
    }


METADATA = ["process_name", "thread_name", "process_sort_index", "thread_sort_index"]
FORMAT = {
    "type": "object",
    "required": ["traceEvents"],
    "properties": {
        "displayTimeUnit": {"enum": ["ms", "ns"]},
        "traceEvents": {
            "items": {
                "oneOf": [
                    phase("X", {"dur": NUMBER}),
                    phase("i", {"s": {"enum": ["g", "p", "t"]}}),
                    phase("C", {"args": {"additionalProperties": {"type": "number"}}}),
                    phase("s", {"id": {"type": "integer"}}),
                    phase("f", {"id": {"type": "integer"}, "bp": {"const": "e"}}),
                    phase("M", {"name": {"enum": METADATA}}),
                ]
            }
        },
    },
}
"""The phases of the trace-event format that are used, as its description has them."""

Event = dict[str, Any]
Place = tuple[int, int]


class Reading:
    """A trace as a reader sees it."""

    def __init__(self, path: Path) -> None:
        opener: Any = gzip.open if path.suffix == ".gz" else open
        with opener(path, "rt", encoding="utf-8") as file:
            self.data = json.load(file)
        self.events: list[Event] = self.data["traceEvents"]
        names = {(e["name"], e["pid"], e["tid"]): e["args"].get("name") for e in self.events if e["ph"] == "M"}
        self.tracks = {
            (names["process_name", pid, 0], name): (pid, tid)
            for (what, pid, tid), name in names.items()
            if what == "thread_name"
        }

    def of(self, letter: str, process: str = "", thread: str = "") -> list[Event]:
        place = self.tracks[process, thread] if process else None
        return [e for e in self.events if e["ph"] == letter and place in (None, (e["pid"], e["tid"]))]

    def arrows(self) -> Iterator[tuple[Event, Event]]:
        starts = {event["id"]: event for event in self.of("s")}
        ends = {event["id"]: event for event in self.of("f")}
        assert starts.keys() == ends.keys()
        yield from ((starts[each], ends[each]) for each in starts)

    def enclosing(self, event: Event) -> list[Event]:
        place = (event["pid"], event["tid"])
        spans = [e for e in self.of("X") if (e["pid"], e["tid"]) == place]
        return [e for e in spans if e["ts"] <= event["ts"] <= e["ts"] + e["dur"]]


def traced(tmp_path: Path, preset: str = "reactive", **changed: Any) -> tuple[Result, Reading]:
    timeline = Timeline()
    if preset == "interruptible":
        changed["learn"] = Learn(slice=5 * ms)
    result = run_stopping(preset, episodes=3, instruments=[timeline], **changed)
    write(timeline, tmp_path / "trace.json", {"scenario": "stopping"})
    return result, Reading(tmp_path / "trace.json")


def assert_nested(spans: list[Event]) -> None:
    """Spans of one track hold one another or lie apart, to the nanosecond."""
    open_until: list[int] = []
    for start, end in sorted((round(e["ts"] * 1e3), -round((e["ts"] + e["dur"]) * 1e3)) for e in spans):
        while open_until and open_until[-1] <= start:
            open_until.pop()
        assert not open_until or -end <= open_until[-1]
        open_until.append(-end)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_trace_keeps_to_the_format_and_holds_the_whole_run(preset: str, tmp_path: Path) -> None:
    result, reading = traced(tmp_path, preset, delay=20 * ms)
    few = [next(e for e in reading.events if e["ph"] == letter) for letter in "XiCsfM"]
    jsonschema.validate(
        {**reading.data, "traceEvents": [*few, *reading.events[:50], *reading.events[-50:]]}, FORMAT
    )
    assert {e["ph"] for e in reading.events} == set("XiCsfM")
    for component in ("act", "observe", "choose"):
        assert len(reading.of("X", "agent", component)) == result.components()[component].count
    assert len(reading.of("X", "agent", "episodes")) == 3
    assert len(reading.of("i", "world", "stimuli")) == 3
    spans = defaultdict(list)
    for event in reading.of("X"):
        spans[event["pid"], event["tid"]].append(event)
    for each in spans.values():
        assert_nested(each)
    learning = reading.of("X", "agent", "learn, beside the loop" if preset == "background" else "learn")
    assert {event["name"] for event in learning} == {"slice" if PRESETS[preset].learn.slice else "learn"}
    assert sum(e["dur"] for e in learning) * 1e3 == pytest.approx(result._learning_time(), rel=1e-6)


def test_an_arrow_leads_from_each_stimulus_to_the_act_that_reacted(tmp_path: Path) -> None:
    result, reading = traced(tmp_path, delay=20 * ms)
    arrows = list(reading.arrows())
    assert len(arrows) == len(result.reaction_times) == 3
    stimuli = {event["ts"] for event in reading.of("i", "world", "stimuli")}
    assert {start["ts"] for start, _ in arrows} == stimuli
    for (start, end), time in zip(arrows, result.reaction_times, strict=True):
        (act,) = (e for e in reading.enclosing(end) if e["name"] == "act")
        assert (act["pid"], act["tid"]) == reading.tracks["agent", "act"]
        assert act["ts"] - start["ts"] == pytest.approx(time / 1e3)
        whole = next(e for e in reading.enclosing(start) if e["name"] == "emergency")
        assert whole["dur"] == pytest.approx(time / 1e3)


def test_who_hears_all_calls_at_once_knows_nothing_of_slices() -> None:
    class AtOnce:
        names: ClassVar[set[str]] = set()

        def noted(self, calls: Sequence[tuple[str, tuple[Any, ...]]]) -> None:
            self.names |= {name for name, _ in calls}

    run_stopping(
        "interruptible", episodes=1, learn=Learn(slice=5 * ms), instruments=[AtOnce(), timeline := Timeline()]
    )
    assert AtOnce.names == set(NOTED)
    assert any(label.name == "learn" and label.kind is Kind.SLICE for label in timeline.labels)


def test_samples_are_shown_where_they_arrived(tmp_path: Path) -> None:
    joint = stopping_joint(sampling=Sampling(rate=100.0, delay=5 * ms))
    _, reading = traced(tmp_path, joint=joint, delay=0)
    samples = reading.of("i", "world", "joint")
    assert len(samples) > 50
    for event in samples:
        assert event["args"]["transport_us"] == 5000
        assert event["ts"] - event["args"]["world_time_us"] == pytest.approx(5000)
    arrivals = [event["ts"] for event in samples]
    assert arrivals == sorted(set(arrivals)), "each is shown once"


def test_the_command_line_writes_it_compressed_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "trace.json.gz"
    assert main(["run", STOPPING, "--clock=virtual", "--episodes=2", "--quiet", f"--trace={path}"]) == 0
    about = Reading(path).data["otherData"]
    assert (about["scenario"], about["clock"], about["dropped"]) == ("stopping", "virtual", 0)


@pytest.mark.parametrize("place", ["", "-", "nowhere/trace.json", "."])
def test_a_place_that_cannot_be_written_to_is_refused_before_the_run(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    code = main(["run", STOPPING, "--clock=virtual", f"--trace={place}", "--quiet"])
    if place == "-":
        assert code == 0
        assert (tmp_path / "-").exists(), "it is a name like any other: results go to standard output, not this"
        return
    assert code == 2
    assert capsys.readouterr().err == f"--trace {place}: give a file in a folder that exists.\n"


def test_a_trace_that_fails_to_be_written_is_told_and_the_results_are_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", STOPPING, "--clock=virtual", "--episodes=1", "--quiet", "--trace=/dev/full"]
    assert main([*command, f"--json={tmp_path / 'result.json'}"]) == 1
    assert "--trace /dev/full: No space left on device" in capsys.readouterr().err
    assert json.loads((tmp_path / "result.json").read_text())["reaction_time"]["count"] == 1


def test_a_run_that_ends_by_a_fault_has_its_trace_with_the_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "trace.json"
    dies = "devices.joint.faults={disconnect=[['300ms']]}"
    assert main(["run", STOPPING, "--clock=virtual", "--quiet", f"--trace={path}", "--set", dies]) == 1
    faults = [event for event in Reading(path).of("i") if event["cat"] == "fault"]
    assert faults
    assert faults[0]["args"]["source"] == "joint"
    assert (faults[-1]["args"]["source"], faults[-1]["s"]) == ("device", "g"), "what ended the run"


def test_what_finds_no_room_takes_the_place_of_the_oldest_and_is_counted(
    tmp_path: Path,
) -> None:
    whole, newest = Timeline(), Timeline(capacity=50)
    run_stopping(episodes=3, instruments=[whole, newest])
    assert list(newest.rows)[-1][1:] == list(whole.rows)[-1][1:]
    assert newest.dropped == whole.rows.count - 50 > 0
    write(newest, tmp_path / "trace.json", {})
    reading = Reading(tmp_path / "trace.json")
    jsonschema.validate(reading.data, FORMAT)
    assert reading.data["otherData"]["dropped"] == newest.dropped


def test_names_and_faults_are_bounded_too() -> None:
    timeline = Timeline(capacity=1)
    for number in range(MOST_FAULTS + 5):
        timeline.fault("arm", f"number {number}", number)
        timeline._code(ACT, str(number))  # type: ignore[arg-type]  # any kind will do
    assert timeline.dropped == 5
    assert len(timeline.labels) <= MOST_LABELS + 1
    assert timeline.labels[-1].name == OTHER


def test_an_episode_that_was_broken_off_is_shown_as_such(tmp_path: Path) -> None:
    timeline = Timeline()
    timeline.episode_began(0, 7, 1000)
    timeline.learned_for(2000, 5000, Where.LOOP)
    write(timeline, tmp_path / "trace.json", {})
    (episode,) = Reading(tmp_path / "trace.json").of("X", "agent", "episodes")
    assert episode == episode | {"name": "trial 0, episode 7", "ts": 0, "dur": 4.0, "args": {"finished": False}}


def test_a_timeline_of_nothing_is_a_trace_too(tmp_path: Path) -> None:
    write(Timeline(), tmp_path / "trace.json", {})
    jsonschema.validate(Reading(tmp_path / "trace.json").data, FORMAT)


@settings(max_examples=30)
@given(st.lists(st.tuples(*[st.integers(-(2**63), 2**63 - 1)] * 5), max_size=20), st.integers(1, 8))
def test_rows_keep_the_newest(rows: list[tuple[int, int, int, int, int]], capacity: int) -> None:
    kept = Rows(capacity)
    for row in rows:
        kept.append(*row)
    assert list(kept) == rows[-capacity:]
    assert kept.dropped == max(0, len(rows) - capacity)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 50), st.integers(1, 20)), max_size=20))
def test_nothing_overlaps_in_a_lane(spans: list[tuple[int, int]]) -> None:
    lanes, until = Lanes(), defaultdict[str, int](int)
    for start, length in sorted(spans):
        track = lanes.take(start, start + length)
        assert until[track.name] <= start
        until[track.name] = start + length
    most = max((sum(s <= start < s + n for s, n in spans) for start, _ in spans), default=0)
    assert len(until) == most
