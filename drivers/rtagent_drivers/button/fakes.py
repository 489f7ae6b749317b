"""The button's fakes: presses drawn beforehand, and the driver itself with a process that presses it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.random import Generator

from rtagent.clock import current
from rtagent.device import Device
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample, Stimulus
from rtagent.streams import stream
from rtagent.units import ms, second
from rtagent_drivers.button.driver import Button
from rtagent_drivers.button.fake_presses import FakePresses
from rtagent_drivers.button.presses import SPEC, Change, Presses


def in_process(**settings: Any) -> Device:
    """Return a button that is pressed at times drawn when an episode begins; it works under both clocks."""
    Button(**settings)  # refuses what the driver refuses
    return FakeButton(settings.get("fake", FakePresses()), settings.get("shortest", 20 * ms))


def on_wire(**settings: Any) -> Device:
    """Return the driver itself, listening at a Unix socket, and pressed from there by a process of its own."""
    Button(**settings)
    return PressedButton(settings)


class FakeButton:
    """A button pressed by the clock alone."""

    spec = SPEC

    def __init__(self, fake: FakePresses, shortest: int) -> None:
        self._fake, self._presses = fake, Presses(shortest)
        self._opened = False
        self._next: Change | None = None
        self._coming: Iterator[Change] = iter(())
        self.counters: Mapping[str, int] = self._presses.counters

    async def open(self) -> None:
        """Begin; the first presses follow from no seed."""
        self._clock = current()
        self._opened = True
        if self._next is None:
            self._begin(stream(0, "button"))

    async def begin_episode(self, rng: Generator) -> None:
        """Draw the presses of an episode."""
        self._check_open()
        self._begin(rng)

    async def read(self, newer_than: int) -> Sample:
        """Return the state that is shown, or wait for one numbered above `newer_than`."""
        while True:
            self._check_open()
            now = self._clock.now()
            self._take(now)
            sample = self._presses.sample(now)
            if sample.sequence > newer_than:
                return sample
            await self._clock.sleep_until(self._next_change())

    async def act(self, command: Command) -> Command:
        """Refuse: it is pressed, and told nothing."""
        self._check_open()
        for name in command:
            raise SpecError(f"a button has no actuator {name!r}.")
        return {}

    async def make_safe(self) -> None:
        """Do nothing: it moves nothing."""

    async def close(self) -> None:
        """Stop."""
        self._opened = False

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the presses with after < time <= until (ns), in order."""
        if self._opened:
            self._take(min(until, self._clock.now()))
        return self._presses.stimuli(after, until)

    def next_event(self, now: int) -> int | None:
        """Return when something is shown next."""
        self._take(now)
        return max(self._next_change(), now + 1)

    def _begin(self, rng: Generator) -> None:
        now = self._clock.now()
        self._presses.begin(now)
        if self._presses.told:
            self._presses.add(Change(False, now, now, "truth"))
        self._coming = _changes(self._fake.intervals(rng), now)
        self._next = next(self._coming)

    def _take(self, now: int) -> None:
        while self._next is not None and self._next.time <= now:
            self._presses.add(self._next)
            self._next = next(self._coming)

    def _next_change(self) -> int:
        coming = self._next.time if self._next is not None else 0
        return coming if self._presses.due is None else min(coming, self._presses.due)

    def _check_open(self) -> None:
        if not self._opened:
            raise DisconnectedError("the button is closed: open it first.")


def _changes(intervals: Iterator[tuple[int, int]], now: int) -> Iterator[Change]:
    for until_press, held in intervals:
        for pressed, wait in ((True, until_press), (False, held)):
            now += wait
            yield Change(pressed, now, now, "truth")


class PressedButton(Button):
    """The driver with a process that presses it; the process ends when its connection does."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self._fake: FakePresses = settings.get("fake", FakePresses())
        self._path = str(Path(tempfile.gettempdir()) / f"rtagent-button-{secrets.token_hex(8)}")
        super().__init__(source="unix", path=self._path, shortest=settings.get("shortest", 20 * ms))
        self._presser: asyncio.subprocess.Process | None = None

    async def open(self) -> None:
        """Listen, and have it pressed."""
        await super().open()
        given = json.dumps([self._path, self._fake.every, self._fake.held])
        self._presser = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, given)

    async def close(self) -> None:
        """Stop listening; the process that presses ends with its connection."""
        await super().close()
        presser, self._presser = self._presser, None
        if presser is not None:
            with contextlib.suppress(ProcessLookupError):
                presser.terminate()
            await presser.wait()


async def press(path: str, fake: FakePresses) -> None:
    """Press the button that listens at `path`, until it does no more."""
    _, writer = await asyncio.open_unix_connection(path)
    clock = current()
    for until_press, held in fake.intervals(stream(0, "button")):
        for event, wait in (("press", until_press), ("release", held)):
            await asyncio.sleep(wait / second)
            writer.write(json.dumps({"event": event, "time": clock.now()}).encode() + b"\n")
            await writer.drain()


if __name__ == "__main__":
    socket_path, every, held_for = json.loads(sys.argv[1])
    with contextlib.suppress(ConnectionError, FileNotFoundError):
        asyncio.run(press(socket_path, FakePresses(tuple(every), tuple(held_for))))
