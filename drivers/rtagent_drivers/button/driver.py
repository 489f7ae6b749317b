"""A button as a device: a key of the terminal, or a message from a socket."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar, Literal

from numpy.random import Generator

from rtagent.clock import current
from rtagent.device import Device
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample, Stimulus
from rtagent.units import Duration, ms, second
from rtagent_drivers.button.fake_presses import NOW_AND_THEN, FakePresses
from rtagent_drivers.button.keyboard import Keyboard
from rtagent_drivers.button.presses import SPEC, Change, Presses
from rtagent_drivers.button.sockets import TCPSource, UnixSource
from rtagent_drivers.button.sources import Source, Viewer

SourceName = Literal["keyboard", "tcp", "unix", "viewer"]

OLDEST = 1 * second
"""A sender's time is believed where it is not in the future, and no longer ago."""


class Button:
    """A push button: the flag `pressed`, and a stimulus at each press.

    `source`: "keyboard", the key `key` of the terminal (released after `release_after` where the terminal tells of
    no releases); "tcp", messages to `host`:`port`; "unix", messages to the socket `path`; "viewer", whoever watches
    the run. A press is shown until it was seen, and for `shortest` longer. Times are the sender's where it gives
    one that can be ("device"), else of arrival. Raises `SpecError` for settings that do not fit together.
    """

    spec = SPEC
    fakes: ClassVar[Mapping[str, Callable[..., Device]]]

    def __init__(
        self,
        *,
        source: SourceName = "keyboard",
        key: str = "b",
        release_after: Duration = 600 * ms,
        host: str = "127.0.0.1",
        port: int = 0,
        token_file: str = "",
        path: str = "",
        shortest: Duration = 20 * ms,
        fake: FakePresses = NOW_AND_THEN,
    ) -> None:
        if shortest < 0 or release_after <= 0:
            raise SpecError("shortest is negative, or release_after is not above 0: give times.")
        self._source: Source
        if source == "keyboard":
            self._source = Keyboard(key, release_after)
        elif source == "tcp":
            self._source = TCPSource(host, port, token_file)
        elif source == "unix":
            self._source = UnixSource(path)
        else:
            self._source = Viewer()
        self._presses = Presses(shortest)
        self.counters = self._presses.counters
        self._opened, self._error = False, DisconnectedError("the button is closed: open it first.")

    async def open(self) -> None:
        """Begin to listen."""
        self._clock, self._changed = current(), asyncio.Event()
        self._presses.begin(self._clock.now())
        await self._source.open(self)
        self._opened = True

    async def begin_episode(self, rng: Generator) -> None:
        """Forget what was pressed before; a button that is held stays so."""
        self._check_open()
        self._presses.begin(self._clock.now())

    async def read(self, newer_than: int) -> Sample:
        """Return the state that is shown, or wait for one numbered above `newer_than`."""
        while True:
            self._check_open()
            self._changed.clear()
            sample = self._presses.sample(self._clock.now())
            if sample.sequence > newer_than:
                return sample
            await self._wait(self._presses.due)

    async def act(self, command: Command) -> Command:
        """Refuse: it is pressed, and told nothing."""
        self._check_open()
        for name in command:
            raise SpecError(f"a button has no actuator {name!r}.")
        return {}

    async def make_safe(self) -> None:
        """Do nothing: it moves nothing."""

    async def close(self) -> None:
        """Stop listening."""
        if self._opened:
            self.lose(DisconnectedError("the button is closed: open it first."))
        await self._source.close()

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the presses with after < time <= until (ns), in order, also those too short to be seen."""
        return self._presses.stimuli(after, until)

    def press(self, at: int | None = None) -> None:
        """Be pressed, now or at a time (ns) that has just passed, and released, by somebody who watches the run."""
        if self._opened:
            self.hear(True, at)
            self.hear(False)

    # What its source tells

    def hear(self, pressed: bool, sent_at: int | None = None) -> None:
        """Hear of a press or a release, now or at a time by its sender's word."""
        now = self._clock.now()
        believed = sent_at is not None and now - OLDEST <= sent_at <= now
        if sent_at is not None and not believed:
            self.counters["times_not_believed"] += 1
        time = sent_at if believed and sent_at is not None else now
        self._presses.add(Change(pressed, time, now, "device" if believed else "arrival"))
        self._changed.set()

    def lose(self, error: DisconnectedError) -> None:
        """Hear that nothing more can be heard; reads tell."""
        self._opened, self._error = False, error
        self._changed.set()

    def _check_open(self) -> None:
        if not self._opened:
            raise DisconnectedError(str(self._error))

    async def _wait(self, due: int | None) -> None:
        """Wait for a change, at most until the next one may be shown (ns)."""
        limit = None if due is None else max(due - self._clock.now(), 0) / second
        try:
            async with asyncio.timeout(limit):
                await self._changed.wait()
        except TimeoutError:
            return


def _in_process(**settings: object) -> Device:
    from rtagent_drivers.button.fakes import in_process

    return in_process(**settings)


def _on_wire(**settings: object) -> Device:
    from rtagent_drivers.button.fakes import on_wire

    return on_wire(**settings)


Button.fakes = {"process": _in_process, "wire": _on_wire}
