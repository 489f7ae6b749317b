"""A recording as a world: it is played at its own times, whoever looks; each session is an episode."""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from numpy.random import Generator

from rtagent.clock import current
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Duration, Frequency, second
from rtagent_drivers.arm import ArmWorld
from rtagent_drivers.fake import CLOSED_SETTINGS
from rtagent_drivers.recorded import Recording, Signal, declared, record, recording_of
from rtagent_drivers.tables import read_table

ENDED = "ended"
PLACE = ("_episode", "_start", "_seen", "_skipped")
"""What is saved."""


class RecordingDevice:
    """A recording, played `speed` times as fast; its newest row is a function of the clock.

    A session begins with its first usable row and ends with its last, at which the flag `ended` is set. The
    sequence of a sample is its row in the session, from 0; rows that nobody looked at in time are `rows_skipped`.
    """

    def __init__(self, recording: Recording, speed: float = 1.0) -> None:
        if not 0.0 < speed < float("inf"):
            raise SpecError(f"speed is {speed}: give a number above 0.")
        if ENDED in recording.specs:
            raise SpecError(
                f"{recording.name}: {ENDED!r} is the recording's own flag: give the signal another name."
            )
        self.recording, self._speed = recording, speed
        rate = speed * second / recording.interval if recording.interval else 0.0
        self.spec = DeviceSpec(sensors={**recording.specs, ENDED: Spec.flag()}, rate=rate)
        self.episodes = len(recording.sessions)
        self._names = tuple(recording.specs)
        self._opened = self._begun = False
        self._episode: int | None = None
        self._past: Counter[str] = Counter()
        self._skipped = 0

    @property
    def notes(self) -> Sequence[str]:
        """What it is, and what of it is left out or guessed."""
        return list(self.recording.notes())

    async def open(self) -> None:
        """Begin to play the first session, unless one is played already."""
        self._clock = current()
        self._opened = True
        if not self._begun:
            self._begin(0)

    async def begin_episode(self, rng: Generator) -> None:
        """Go on to the next session, or to the first again; its first usable row is now."""
        self._check_open()
        if self._episode is not None:
            self._past += self._damage()
        self._episode = 0 if self._episode is None else self._episode + 1
        self._begin(self._episode % self.episodes)

    async def read(self, newer_than: int) -> Sample:
        """Return the newest row, or wait for the one above `newer_than` (for ever, where there is none)."""
        self._check_open()
        if newer_than >= self._session.last:
            await asyncio.get_running_loop().create_future()
        while (row := self._newest()) <= newer_than:
            await self._clock.sleep_until(self._due(newer_than + 1))
            self._check_open()
        return self._sample(row)

    async def act(self, command: Command) -> Command:
        """Refuse: nothing can be done about the past."""
        for name in command:
            raise SpecError(f"there is no actuator {name!r}: a recording can only be watched.")
        return {}

    async def make_safe(self) -> None:
        """Do nothing: nothing moves."""

    async def close(self) -> None:
        """Stop."""
        self._opened = False

    def next_event(self, now: int) -> int | None:
        """Return the time of the next row, or None after the last."""
        following = bisect_right(self._times, now - self._start)
        return self._start + self._times[following] if following <= self._session.last else None

    @property
    def counters(self) -> Mapping[str, int]:
        """What the rows that were played had missing or outside its range, gaps, and rows that nobody looked at."""
        return self._past + self._damage() + Counter(rows_skipped=self._skipped)

    def save(self) -> Saved:
        """Return which row of which session was seen last, when that began, and what was counted before."""
        return save_fields(self, PLACE) | {"past": dict(self._past)}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, before it is opened: it then goes on from there."""
        self._take_up((saved["_episode"] or 0) % self.episodes)
        self._start, self._seen = 0, 0
        restore_fields(self, PLACE, saved)
        self._past, self._begun = Counter(saved["past"]), True

    def _begin(self, number: int) -> None:
        self._take_up(number)
        self._start, self._begun = self._clock.now(), True
        self._seen = self._session.first - 1

    def _take_up(self, number: int) -> None:
        session = self._session = self.recording.sessions[number]
        offsets = (session.times - session.times[session.first]) / self._speed
        self._times: list[int] = offsets.round().astype(int).tolist()

    def _newest(self) -> int:
        passed = bisect_right(self._times, self._clock.now() - self._start, lo=max(self._seen, 0))
        return min(passed - 1, self._session.last)

    def _due(self, row: int) -> int:
        return self._start + self._times[row]

    def _sample(self, row: int) -> Sample:
        if row > self._seen:
            self._skipped += row - self._seen - 1
            self._seen = row
        values: dict[str, float | bool] = dict(zip(self._names, self._session.values[row].tolist(), strict=True))
        values[ENDED] = row == self._session.last
        time = self._due(row)
        return Sample(values, time, time, row, "device")

    def _damage(self) -> Counter[str]:
        """Return what was damaged in the rows played in this episode, with those after its last usable one."""
        if self._episode is None:
            return Counter()
        session = self._session
        end = None if self._seen == session.last else self._seen + 1
        return self.recording.damage(session, slice(end))

    def _check_open(self) -> None:
        if not self._opened:
            raise DisconnectedError("the recording is closed: open it first.")


@dataclass(frozen=True)
class ArmRecording:
    """A recording that the fake arm makes: how long, how often, with how many joints, from which seed."""

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    duration: Duration = 600 * second
    rate: Frequency = 30.0
    joints: int = 5
    seed: int = 1

    def make(self, signals: Mapping[str, Signal] | None) -> Recording:
        """Make the recording, of these signals or of all that the arm senses."""
        world = ArmWorld(self.joints)
        table = record(world, self.duration, self.rate, self.seed)
        return recording_of(table, "the fake arm's recording", signals or declared(world))


def recording(
    *,
    file: str = "",
    time: str = "",
    session: str = "",
    signals: dict[str, Signal] | None = None,
    speed: float = 1.0,
    arm: ArmRecording = ArmRecording(),  # frozen: sharing it changes nothing
) -> RecordingDevice:
    """A recording, played at its own times: CSV, gzipped CSV or npz, or one that the fake arm makes."""
    if not file:
        return RecordingDevice(arm.make(signals), speed)
    wanted = [given.column or name for name, given in (signals or {}).items()]
    return RecordingDevice(recording_of(read_table(Path(file), time, session, wanted), file, signals), speed)
