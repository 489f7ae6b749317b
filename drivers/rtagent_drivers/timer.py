"""A timer as a device: what calls for a reaction where no person and no sensor does."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from math import inf

from numpy.random import Generator

from rtagent.clock import current
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample, Stimulus
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Duration, ms

EXPIRED = "expired"


class Timer:
    """A timer that expires once in each episode, `after` a time drawn uniformly from [earliest, latest].

    Its flag `expired` is a signal and its turning true a stimulus, whose time is the timer's own. It has a new
    sample only when it expires. Raises `SpecError` where `after` is no range of times.
    """

    spec = DeviceSpec(sensors={EXPIRED: Spec.flag()}, rate=inf)

    def __init__(self, *, after: tuple[Duration, Duration] = (500 * ms, 1500 * ms)) -> None:
        if not 0 < after[0] <= after[1]:
            raise SpecError("after is [earliest, latest], both above 0 and in this order.")
        self._after = after
        self._opened = self._restored = False
        self._began = self._due = 0

    async def open(self) -> None:
        """Begin to run; no episode has begun yet, and it does not expire before one has."""
        self._clock = current()
        self._opened = True
        if not self._restored:
            self._began, self._due = self._clock.now(), 0
        self._restored = False

    async def begin_episode(self, rng: Generator) -> None:
        """Wind it up."""
        self._check_open()
        self._began = self._clock.now()
        self._due = self._began + int(rng.integers(*self._after, endpoint=True))

    async def read(self, newer_than: int) -> Sample:
        """Return whether it has expired (numbered 1) or not (0), or wait until it does."""
        self._check_open()
        while self._expired <= newer_than:
            if self._expired or not self._due:
                await asyncio.get_running_loop().create_future()
            await self._clock.sleep_until(self._due)
            self._check_open()
        expired = self._expired
        since = self._due if expired else self._began
        return Sample({EXPIRED: expired}, since, since, int(expired))

    async def act(self, command: Command) -> Command:
        """Refuse: there is nothing to be told."""
        self._check_open()
        for name in command:
            raise SpecError(f"a timer has no actuator {name!r}.")
        return command

    async def make_safe(self) -> None:
        """Do nothing: it moves nothing."""

    async def close(self) -> None:
        """Stop it."""
        self._opened = False

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return its expiry, if it lies between."""
        return (Stimulus(self._due, EXPIRED),) if self._due and after < self._due <= until else ()

    def next_event(self, now: int) -> int | None:
        """Return when it expires, if that is to come."""
        return self._due if self._due > now else None

    def save(self) -> Saved:
        """Return when it was wound up, and when it expires."""
        return save_fields(self, ("_began", "_due"))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, before it is opened: it then goes on from there."""
        restore_fields(self, ("_began", "_due"), saved)
        self._restored = True

    @property
    def _expired(self) -> bool:
        return bool(self._due) and self._clock.now() >= self._due

    def _check_open(self) -> None:
        if not self._opened:
            raise DisconnectedError("the timer is closed: open it first.")
