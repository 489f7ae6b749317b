"""Recordings as telemetry makes them: from the records of an MCAP file to what a replay needs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rtagent.errors import ReplayError
from rtagent.experience import Observation, Sample
from rtagent.replay.events import Acted, Began, Chose, Ended, Event, Knew, Learned, Observed, Recorded
from rtagent.specs import Value
from rtagent.telemetry import records
from rtagent.telemetry.connection import TelemetryError
from rtagent.telemetry.reading import WHOLE, Scan
from rtagent.telemetry.records import Record

NEEDED = ("run", "event", "sample", "observation", "choice", "action", "transition", "episode")
"""The streams that are read: nothing of them may be missing."""


def read_recording(path: Path) -> Recorded:
    """Return what an MCAP file holds, read when it is asked for; raise `ReplayError` where that is no recording."""
    with _told_as_replays():
        scan = Scan(path)
        run = next((entry.record() for entry in scan if entry.stream == "run"), None)
    if not scan.ends():
        raise _cut_off(path)
    if not isinstance(run, records.Run):
        raise ReplayError(f"{path} tells of no run: give a recording that `rtagent run --record` has made.")
    return Recorded(_given(run.scenario), _events(path, run))


@contextmanager
def _told_as_replays() -> Iterator[None]:
    try:
        yield
    except TelemetryError as error:
        raise ReplayError(str(error)) from None


def _events(path: Path, run: records.Run) -> Iterator[Event]:
    reading, scan = _Reading(path, run), Scan(path)
    with _told_as_replays():
        for entry in scan:
            if entry.stream in NEEDED:
                reading.check_whole(entry.stream, entry.sequence)
                yield from reading.events(entry.record())
    if scan.damage != WHOLE:
        raise _cut_off(path)


def _cut_off(path: Path) -> ReplayError:
    return ReplayError(f"{path} was cut off or damaged: `rtagent recover {path}` makes one that was cut off whole.")


class _Reading:
    """Follows the records of a recording; an observation is made of the newest samples."""

    def __init__(self, path: Path, run: records.Run) -> None:
        self._path = path
        self._arrays = {name: _arrays(device) for name, device in run.devices.items()}
        self._next: defaultdict[str, int] = defaultdict(int)
        self._samples: dict[str, Sample] = {}

    def check_whole(self, stream: str, number: int) -> None:
        """Raise `ReplayError` where records of a stream are missing before this one; the run's may be."""
        expected, self._next[stream] = self._next[stream], number + 1
        if number != expected and stream != "run":
            raise ReplayError(
                f"{self._path} lacks {number - expected} records of {stream} before number {number}: "
                "what is not whole cannot be replayed. Record with a larger telemetry.buffer."
            )

    def events(self, record: Record) -> Iterator[Event]:
        """Yield what a record means."""
        match record:
            case records.Sample():
                self._samples[record.device] = self._sample(record)
            case records.Observation():
                yield Observed(self._observation(record))
            case records.Choice():
                yield Chose(record.action, record.probability, record.learned, record.pieces)
            case records.Action():
                yield Acted()
            case records.Transition():
                yield Learned(float("nan") if record.delta is None else record.delta)
            case records.Episode():
                yield Ended()
            case records.Event(name="episode", trial=int(trial), episode=int(episode)):
                yield Began(trial, episode, record.time_ns)
            case records.Event(name="learned"):
                yield Knew(record.text)

    def _sample(self, record: records.Sample) -> Sample:
        arrays = self._arrays.get(record.device, {})
        values: dict[str, Value] = {
            name: np.array(value, arrays[name]) if name in arrays else _number(value)
            for name, value in record.values.items()
        }
        source: Any = record.time_source
        return Sample(values, record.world_time_ns, record.arrival_time_ns, record.number, source)

    def _observation(self, record: records.Observation) -> Observation:
        for device, number in record.samples.items():
            if device not in self._samples or self._samples[device].sequence != number:
                raise ReplayError(f"{self._path} lacks sample {number} of {device!r}, which was observed.")
        samples = {device: self._samples[device] for device in record.samples}
        return Observation(record.time_ns, samples, frozenset(record.stale))


def _arrays(device: records.DeviceSignals) -> Mapping[str, str]:
    """Return the types of those sensors that are arrays."""
    return {name: signal.dtype for name, signal in device.sensors.items() if signal.shape}


def _given(table: Any) -> Any:
    """Return a table without what is None: JSON has no infinity, which is a default wherever it is."""
    if isinstance(table, dict):
        return {name: _given(value) for name, value in table.items() if value is not None}
    return [_given(value) for value in table] if isinstance(table, list) else table


def _number(value: Any) -> Value:
    return value  # type: ignore[no-any-return]  # what is no array is a number
