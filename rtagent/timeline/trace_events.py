"""From a timeline to the trace-event format of Chrome, in JSON, which Perfetto reads too.

The format: "Trace Event Format", docs.google.com/document/d/1CvAClvFfyA5R-PhYUmn5OOQtYMH4h6I0nSsKchNAySU.
Times there are in µs; they count from the first thing that is shown.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator, Mapping
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, TextIO

from rtagent.schedule import Component
from rtagent.timeline.recording import Kind, Timeline
from rtagent.timeline.rows import Row
from rtagent.timeline.tracks import AGENT, ELSEWHERE, EPISODES, STIMULI, WORLD, Lanes, Track, Tracks

SHORTEST = 1
"""What takes no time, as much does under the virtual clock, is shown as long as this (ns): arrows end in it."""

PARTS = ("sensing", "deciding", "acting")

Event = dict[str, Any]


def write(timeline: Timeline, path: str | Path, about: Mapping[str, Any]) -> None:
    """Write a timeline as a trace, gzipped where `path` ends in .gz; `about` is what is told of the run.

    Raises `OSError` where it cannot be written.
    """
    opener: Any = gzip.open if str(path).endswith(".gz") else open
    with opener(path, "wt", encoding="utf-8") as out:
        _write(timeline, out, about)


def _write(timeline: Timeline, out: TextIO, about: Mapping[str, Any]) -> None:
    events = TraceEvents(timeline)
    out.write('{"displayTimeUnit": "ns",\n"traceEvents": [\n')
    for number, event in enumerate(events):
        out.write((",\n" if number else "") + json.dumps(event, ensure_ascii=False))
    told = {**about, "dropped": timeline.dropped, "first_ns": events.first}
    out.write(f'\n],\n"otherData": {json.dumps(told, ensure_ascii=False)}}}\n')


class TraceEvents:
    """The events of a trace, as plain data for JSON; `first` is the time (ns) that its times count from."""

    def __init__(self, timeline: Timeline) -> None:
        self._timeline, self._tracks = timeline, Tracks()
        rows = (row[1] for row in timeline.rows)
        faults = (fault.time for fault in timeline.faults)
        episodes = [episode.began for episode in timeline.episodes]
        self.first = min(chain(rows, faults, episodes, (timeline.began or ())[2:]), default=0)
        self._last = max((row[2] for row in timeline.rows), default=self.first)

    def __iter__(self) -> Iterator[Event]:
        yield from self._episodes()
        for row in self._timeline.rows:
            yield from self._of_row(row)
        yield from self._reactions()
        yield from self._faults()
        yield from self._tracks.names()

    def _kind(self, row: Row) -> Kind:
        return self._timeline.labels[row[0]].kind

    def _of_row(self, row: Row) -> Iterator[Event]:
        code, start, end, value, _ = row
        kind, name = self._timeline.labels[code]
        if kind is Kind.COMPONENT:
            yield self._span(Track(AGENT, name), name, kind, start, end)
        elif kind is Kind.SLICE:
            yield self._span(Track(AGENT, Component.LEARN.value), "slice", kind, start, end)
        elif kind is Kind.ELSEWHERE:
            yield self._span(Track(AGENT, ELSEWHERE), name, kind, start, end)
        elif kind is Kind.ACTION:
            yield self._event("C", Track(AGENT, name), name, kind, end, args={name: value})
        elif kind is Kind.SAMPLE:
            args = {"sequence": value, "world_time_us": self._us(start), "transport_us": (end - start) / 1e3}
            yield self._event("i", Track(WORLD, name), kind, kind, end, s="t", args=args)
        elif kind is Kind.STIMULUS:
            args = {"observed_after_us": (end - start) / 1e3}
            yield self._event("i", Track(WORLD, STIMULI), name, kind, start, s="t", args=args)

    def _reactions(self) -> Iterator[Event]:
        """Yield each reaction on a lane that is free for it."""
        lanes = Lanes()
        reactions = [row for row in self._timeline.rows if self._kind(row) is Kind.REACTION]
        for number, row in enumerate(sorted(reactions, key=lambda row: row[1]), 1):
            yield from self._reaction(row, lanes.take(row[1], row[2]), number)

    def _reaction(self, row: Row, track: Track, number: int) -> Iterator[Event]:
        """Yield a reaction, its parts within it, and an arrow from the stimulus to the act that reacted."""
        code, start, end, observed, act = row
        yield self._span(track, self._timeline.labels[code].name, Kind.REACTION, start, end)
        for part, (began, ended) in zip(PARTS, pairwise((start, observed, act, end)), strict=True):
            if ended > began:
                yield self._span(track, part, Kind.REACTION, began, ended)
        yield self._event("s", track, "reaction", Kind.REACTION, start, id=number)
        to = Track(AGENT, Component.ACT.value)
        yield self._event("f", to, "reaction", Kind.REACTION, act, id=number, bp="e")

    def _episodes(self) -> Iterator[Event]:
        track = Track(AGENT, EPISODES)
        for record in self._timeline.episodes:
            args = {"return": record.total_reward, "steps": record.steps, "truncated": record.truncated}
            name = f"trial {record.trial}, episode {record.episode}"
            yield self._span(track, name, "episode", record.began, record.ended, args)
        if self._timeline.began is not None:
            trial, episode, began = self._timeline.began
            name = f"trial {trial}, episode {episode}"
            yield self._span(track, name, "episode", began, max(began, self._last), {"finished": False})

    def _faults(self) -> Iterator[Event]:
        for fault in self._timeline.faults:
            name, args = f"fault: {fault.source}", {"source": fault.source, "message": fault.message}
            yield self._event("i", Track(AGENT, EPISODES), name, "fault", fault.time, s="g", args=args)

    def _span(
        self, track: Track, name: str, category: str, start: int, end: int, args: Mapping[str, Any] | None = None
    ) -> Event:
        extra = {"args": args} if args else {}
        return self._event("X", track, name, category, start, dur=max(end - start, SHORTEST) / 1e3, **extra)

    def _event(self, phase: str, track: Track, name: str, category: str, time: int, **more: Any) -> Event:
        process, thread = self._tracks.numbers(track)
        place = {"pid": process, "tid": thread, "ts": self._us(time)}
        return {"name": str(name), "cat": str(category), "ph": phase, **place, **more}

    def _us(self, time: int) -> float:
        return (time - self.first) / 1e3
