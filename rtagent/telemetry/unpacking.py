"""From what the loop wrote to records: the sender's side of the buffer."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from rtagent.telemetry import records
from rtagent.telemetry.packing import unpack
from rtagent.telemetry.records import STREAM_OF, Record

Calls = Sequence[tuple[str, Sequence[Any]]]

DEVICE_SAMPLE = ("values", "world_time_ns", "arrival_time_ns", "number", "time_source")


class Unpacker:
    """Makes records, numbers them by stream, and knows what of each stream was lost.

    `actions` are the names of the run's actions. What is told of the run as a whole is kept: its `demons`, how it
    `ended`, its `counts`; `run_changed` says whether there is something new of it.
    """

    def __init__(self, actions: Sequence[str]) -> None:
        self._actions = actions
        self._order: Any = ()
        self._precision = "float32"
        self.demons: list[records.DemonAbout] = []
        self.ended = ""
        self.run_changed = False
        self._next: Counter[str] = Counter()
        self.lost: Counter[str] = Counter()
        self.counts: dict[str, int] = {}
        self._last_sample: dict[str, tuple[int, int]] = {}
        self._about = self._learned_at = 0
        self._chosen: tuple[float, int | None] = (1.0, None)
        self._progress = (0, 0)
        self.time = 0
        """The time of the newest record, in ns."""

    def make(self, kind: type[Record], time: int, /, **fields: Any) -> Record:
        """Return the next record of its stream."""
        stream = STREAM_OF[kind]
        sequence = self._next[stream]
        self._next[stream] = sequence + 1
        self.time = max(self.time, time)
        return kind(sequence=sequence, time_ns=time, **fields)

    def __call__(self, message: bytes, heard: Callable[[Calls], None] = lambda calls: None) -> Iterator[Record]:
        """Yield the records of a message; its calls are `heard` first."""
        lost, calls, newest = unpack(message)
        heard(calls)
        if lost is not None:
            self._skip(*lost)
        components: dict[str, int] = {}
        for name, args in calls:
            if name == "component":
                component, start, end = args
                components[component] = components.get(component, 0) + end - start
                last = end
            else:
                yield from getattr(self, f"_{name}")(*args)
        if newest is not None:
            values = np.frombuffer(newest, self._precision)[self._order]
            yield self.make(
                records.Prediction, self._learned_at, about_ns=self._about, values=_finite(values.tolist())
            )
        if components:
            yield self.make(records.Components, last, **components)

    def _skip(self, counts: dict[str, int], samples: dict[str, Sequence[Any]]) -> None:
        """Leave the numbers of records out that were lost."""
        lost = Counter(counts)
        for device, (first, last, count) in samples.items():
            lost["sample"] += count - (tuple(first) == self._last_sample.get(device))
            self._last_sample[device] = tuple(last)
        self.lost += lost
        self._next += lost

    def _trial_began(self, trial: int, about: Any, places: Sequence[int], precision: str) -> Iterator[Record]:
        self._order, self._precision = np.argsort(places), precision
        self.demons = [records.DemonAbout(*about[number]) for number in self._order]
        self.run_changed = True
        return iter(())

    def _counted(self, counts: dict[str, int]) -> Iterator[Record]:
        self.counts = counts
        return iter(())

    def _run_ended(self, how: str) -> Iterator[Record]:
        self.ended, self.run_changed = how, True
        return iter(())

    def _observed(self, observation: Any, stimuli: Any) -> Iterator[Record]:
        time, samples, stale = observation
        for device, sample in samples.items():
            fields = dict(zip(DEVICE_SAMPLE, sample, strict=True))
            this = (fields["number"], fields["arrival_time_ns"])
            if this != self._last_sample.get(device):
                self._last_sample[device] = this
                yield self.make(records.Sample, fields["arrival_time_ns"], device=device, **fields)
        numbers = {device: sample[3] for device, sample in samples.items()}
        yield self.make(records.Observation, time, samples=numbers, stale=sorted(stale))
        for happened, kind, source in stimuli:
            yield self.make(records.Stimulus, time, kind=kind, happened_ns=happened, time_source=source)

    def _chose(self, action: int, probability: float, time: int) -> Iterator[Record]:
        self._chosen = (probability, time)
        learned, pieces = self._progress
        yield self.make(
            records.Choice, time, action=action, probability=probability, learned=learned, pieces=pieces
        )

    def _had_learned(self, transitions: int, pieces: int) -> Iterator[Record]:
        self._progress = (transitions, pieces)
        return iter(())

    def _acted(self, action: int, sent: Any, start: int, end: int) -> Iterator[Record]:
        probability, chosen = self._chosen
        self._chosen = (probability, None)
        name = self._actions[action]
        yield self.make(
            records.Action, end, action=action, name=name, probability=probability, chosen_ns=chosen,
            began_ns=start, sent={device: taken or {} for device, taken in sent.items()},
        )  # fmt: skip

    def _learned(self, *args: Any) -> Iterator[Record]:
        *step, state, next_state, complete_at, delta, time = args
        self._about, self._learned_at = complete_at, time
        names = ("action", "next_action", "probability", "reward", "elapsed_ns", "terminated", "truncated")
        yield self.make(
            records.Transition, time, **dict(zip(names, step, strict=True)),
            state=_finite(state), next_state=_finite(next_state), complete_at_ns=complete_at, delta=delta,
        )  # fmt: skip

    def _reacted(self, reaction: Any) -> Iterator[Record]:
        happened, kind, _ = reaction["stimulus"]
        parts = {name: reaction[name] for name in ("sensing", "deciding", "acting")}
        total = sum(parts.values())
        yield self.make(
            records.Reaction, happened + total, kind=kind, stimulus_ns=happened, reaction=total, **parts
        )

    def _episode_began(self, trial: int, episode: int, time: int) -> Iterator[Record]:
        text = f"episode {episode} of trial {trial} began"
        yield self.make(records.Event, time, name="episode", text=text, trial=trial, episode=episode)

    def _episode_ended(self, *args: Any) -> Iterator[Record]:
        names = (
            "trial", "episode", "began_ns", "ended_ns", "total_reward", "steps", "truncated", "reactions",
            "responses", "missed_reactions", "missed_responses", "anticipated",
        )  # fmt: skip
        fields = dict(zip(names, args, strict=True))
        yield self.make(records.Episode, fields["ended_ns"], **fields)

    def _trial_ended(self, trial: int, digest: str) -> Iterator[Record]:
        yield self.make(records.Event, self.time, name="learned", text=digest, trial=trial)

    def _fault(self, source: str, message: str, time: int) -> Iterator[Record]:
        yield self.make(records.Fault, time, source=source, message=message)


def _finite(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]
