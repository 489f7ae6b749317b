"""What somebody who watches a run keeps of it: rates, counts, and the newest of each stream, in a few words."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

from rtagent.telemetry import records
from rtagent.telemetry.records import STREAMS, Record
from rtagent.telemetry.subscribe import Message
from rtagent.units import describe

WINDOW = 2.0
"""Rates are of so many seconds."""


class Row(NamedTuple):
    """A stream: records a second, how many there were, how many of them were missed, and the newest."""

    stream: str
    rate: float
    records: int
    missed: int
    newest: str


class Watched:
    """A run that is watched."""

    def __init__(self) -> None:
        self._newest: dict[str, Record] = {}
        self._missed: dict[str, int] = {}
        self._marks: deque[tuple[float, dict[str, int]]] = deque()
        self.run: records.Run | None = None

    def take(self, message: Message) -> None:
        """Keep a message."""
        self._newest[message.stream] = message.record
        self._missed[message.stream] = self._missed.get(message.stream, 0) + message.missed
        if isinstance(message.record, records.Run):
            self.run = message.record

    def state(self) -> str:
        """Say whether it goes on."""
        if self.run is None:
            return ""
        return f"ended: {self.run.ended}" if self.run.ended else f"goes on ({self.run.clock} clock)"

    def rows(self, now: float) -> Iterator[Row]:
        """Yield the streams of which there was something; `now` is in s."""
        counts = {stream: record.sequence + 1 for stream, record in self._newest.items()}
        self._marks.append((now, counts))
        while len(self._marks) > 2 and self._marks[1][0] < now - WINDOW:
            self._marks.popleft()
        then, before = self._marks[0]
        for stream in STREAMS:
            if stream in counts:
                rate = (counts[stream] - before.get(stream, counts[stream])) / (now - then) if now > then else 0.0
                newest = in_words(self._newest[stream])
                yield Row(stream, rate, counts[stream], self._missed[stream], newest)


def in_words(record: Record) -> str:
    """Return what a record says, in a few words."""
    say = WORDS.get(type(record))
    return say(record) if say is not None else ""


def _values(values: Any) -> str:
    return "  ".join(f"{name} {_number(value)}" for name, value in values.items())


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _listed(values: Any) -> str:
    return " ".join("none" if value is None else f"{value:.3g}" for value in values[:12]) + " …" * (
        len(values) > 12
    )


def _components(record: Any) -> str:
    names = ("order", "observe", "choose", "act", "learn", "wait")
    known = [(name, getattr(record, name)) for name in names]
    return "  ".join(f"{name} {describe(value)}" for name, value in known if value is not None)


WORDS: dict[type[Record], Any] = {
    records.Run: lambda run: f"seed {run.seed}, {len(run.demons)} demons, control {'on' if run.control else 'off'}",
    records.Sample: lambda sample: f"{sample.device}: {_values(sample.values)}",
    records.Observation: lambda seen: f"stale: {', '.join(seen.stale) or 'nothing'}",
    records.Action: lambda action: f"{action.name} (probability {action.probability:.3g})",
    records.Transition: lambda step: f"reward {step.reward:.4g}, delta {step.delta or 0:.4g}",
    records.Prediction: lambda prediction: _listed(prediction.values),
    records.Components: _components,
    records.Reaction: lambda reaction: f"to {reaction.kind} in {describe(reaction.reaction)}",
    records.Stimulus: lambda stimulus: stimulus.kind,
    records.Event: lambda event: f"{event.name}: {event.text}",
    records.Fault: lambda fault: f"{fault.source}: {fault.message}",
    records.Counters: lambda counters: _values(counters.values),
    records.Episode: lambda ended: f"episode {ended.episode}: reward {ended.total_reward:.4g}, {ended.steps} steps",
}
