"""Fakes in the process: any world as a device, with a sample rate, transport delay, and faults on demand.

A world's state is a function of the clock. It is computed when it is read, for the moment at which a sensor
would have measured it, so that a loop that was busy finds what a kernel's buffer would hold.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, isfinite
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.clock import current
from rtagent.device import Noting
from rtagent.errors import DeviceError, DisconnectedError, SpecError
from rtagent.experience import Command, FloatArray, Sample, Stimulus, Values
from rtagent.saving import Saveable, Saved
from rtagent.specs import DeviceSpec, Value
from rtagent.streams import restored_stream, save_stream, stream
from rtagent.units import Duration, Frequency, describe
from rtagent_drivers.arrivals import Arrivals, Disturbance

CLOSED_SETTINGS = {"extra": "forbid"}


class World(Protocol):
    """A piece of the world that goes on by itself. All times are in ns; none is asked of the loop.

    One that is `Saveable` saves what has become of it since it began: it is begun again before it is restored.
    """

    spec: DeviceSpec

    def begin(self, now: int, rng: Generator) -> None:
        """Begin an episode at `now`, all that is random in it drawn from `rng`."""

    def values(self, time: int) -> Values:
        """Return what the sensors would measure at `time`, which is not in the future."""

    def command(self, now: int, command: Command) -> Command:
        """Take a command that arrives `now`; return what became of it."""

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the stimuli with after < time <= until."""

    def next_change(self, now: int) -> int | None:
        """Return when something changes next after `now` if no command comes, or None."""

    def make_safe(self, now: int) -> None:
        """Stop all motion."""


@runtime_checkable
class Preparing(Protocol):
    """A world whose start takes long to make, as a simulator's reset may: that is no part of an episode."""

    def prepare(self, rng: Generator) -> None:
        """Make the start of the episode that `begin` is called for next, what is random drawn from `rng`."""


@runtime_checkable
class Columnar(Protocol):
    """A world that can be asked for many moments at once."""

    def columns(self, times: NDArray[np.int64]) -> Mapping[str, FloatArray]:
        """Return what the sensors would measure at these times (ns), shape (n,), by their names."""


@dataclass(frozen=True)
class Sampling:
    """How a world is measured: `rate` in Hz (0: as of now, whenever it is read), and the way to the host.

    A sample arrives `delay` after it was taken, and up to `jitter` later still.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    rate: Frequency = 0.0
    delay: Duration = 0
    jitter: Duration = 0

    def __post_init__(self) -> None:
        if not 0 <= self.rate < inf or self.delay < 0 or self.jitter < 0:
            raise SpecError("sampling has a rate, delay or jitter that is negative or infinite: give 0 or more.")
        if self.jitter and not self.rate:
            raise SpecError("sampling.jitter needs sampling.rate: a world read as of now has no arrivals.")


@dataclass(frozen=True)
class Faults:
    """What goes wrong. Probabilities are for each sample; times are since the device was first opened.

    A `late` sample takes `lateness` longer, so that it may be overtaken. At `raise_at` a call raises, once; at
    `hang_at` a call does not return, once; in each window `disconnect` = [from, to] (or [from], for ever) the
    device is gone.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    drop: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    late: float = 0.0
    lateness: Duration = 0
    raise_at: tuple[Duration, ...] = ()
    hang_at: tuple[Duration, ...] = ()
    disconnect: tuple[tuple[Duration, ...], ...] = ()

    def __post_init__(self) -> None:
        for name in ("drop", "duplicate", "corrupt", "late"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise SpecError(f"faults.{name} is {getattr(self, name)}: give a probability from 0 to 1.")
        if self.lateness < 0:
            raise SpecError("faults.lateness is negative: give 0 or more.")
        if any(len(window) not in (1, 2) for window in self.disconnect):
            raise SpecError("faults.disconnect holds windows [from, to], or [from] for ever.")

    @property
    def in_stream(self) -> Disturbance | None:
        """What disturbs the stream of samples, if anything."""
        if self.drop or self.duplicate or self.corrupt or self.late:
            return Disturbance(self.drop, self.duplicate, self.corrupt, self.late, self.lateness)
        return None


class FakeDevice:
    """A world as a device."""

    def __init__(self, world: World, sampling: Sampling | None = None, faults: Faults | None = None) -> None:
        self._sampling, self._faults = sampling or Sampling(), faults or Faults()
        self.world, self.spec = world, replace(world.spec, rate=self._sampling.rate)
        if self._faults.in_stream and not self._sampling.rate:
            raise SpecError("faults in the stream of samples (drop, duplicate, corrupt, late) need sampling.rate.")
        self._troubles = bool(self._faults.raise_at or self._faults.hang_at or self._faults.disconnect)
        self._due = {"raise": sorted(self._faults.raise_at), "hang": sorted(self._faults.hang_at)}
        self._first_opened: int | None = None
        self._opened_at = 0
        self._opened = False
        self._arrivals: Arrivals | None = None
        self._reads = 0
        self._past_counters: Counter[str] = Counter()
        self._hangs = 0
        self._goes_on_from: int | None = None

    async def open(self) -> None:
        """Connect; raise `DisconnectedError` while it is unplugged."""
        self._clock = current()
        self._now = self._clock.now
        if self._first_opened is None:
            self._begin_world(stream(0, "fake"))
            self._first_opened = self._began
        self._opened_at = self._now() - self._first_opened if self._goes_on_from is None else self._goes_on_from
        self._goes_on_from = None
        self._check_plugged(self._opened_at)
        self._opened = True

    async def begin_episode(self, rng: Generator) -> None:
        """Put the world at its start, now."""
        await self._meet_troubles()
        self._begin_world(rng)

    async def read(self, newer_than: int) -> Sample:
        """Return the newest sample there is, or wait for one above `newer_than`."""
        await self._meet_troubles()
        if self._arrivals is None:
            return self._as_of_now()
        newest = self._arrivals.newest(self._now())
        while newest is None or newest.sequence <= newer_than:
            await self._clock.sleep_until(self._arrivals.next_arrival(self._now()))
            await self._meet_troubles()
            newest = self._arrivals.newest(self._now())
        values = self.world.values(newest.taken)
        if newest.corrupt:
            values = self._corrupted(values, newest.sequence)
        return Sample(values, newest.taken, newest.arrival, newest.sequence)

    async def act(self, command: Command) -> Command:
        """Hand a command to the world; raise `SpecError` where it is none of its actuators."""
        await self._meet_troubles()
        for name, value in command.items():
            if name not in self.spec.actuators:
                there = ", ".join(self.spec.actuators) or "none"
                raise SpecError(f"there is no actuator {name!r}; this device has {there}.")
            self.spec.actuators[name].validate(value, name)
        return self.world.command(self._now(), command)

    async def make_safe(self) -> None:
        """Stop all motion."""
        if self._first_opened is None:
            return
        self._check_plugged(self._now() - self._first_opened)
        self.world.make_safe(self._now())

    async def close(self) -> None:
        """Disconnect."""
        self._opened = False

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the stimuli with after < time <= until (ns), from the truth."""
        return self.world.stimuli(after, until)

    def next_event(self, now: int) -> int | None:
        """Return when the next sample arrives, or the world changes next."""
        if self._arrivals is not None:
            return self._arrivals.next_arrival(now)
        change = self.world.next_change(now - self._sampling.delay)
        return None if change is None else change + self._sampling.delay

    def foretold(self, rng: Generator, length: int) -> tuple[NDArray[np.int64], Mapping[str, FloatArray]]:
        """Return all samples of an episode of `length` (ns) that begins at 0: when each arrives, and the values.

        They are those that `read` would give, all at once; raises `SpecError` where faults or jitter are set, or
        there is no rate.
        """
        sampling = self._sampling
        if not sampling.rate or sampling.jitter or self._faults != Faults():
            raise SpecError("only a fake with a rate, without faults and jitter, can be foretold.")
        count = ceil((length - sampling.delay) * sampling.rate / 1e9)
        taken = np.array([round(number * 1e9 / sampling.rate) for number in range(count)], np.int64)
        self.world.begin(0, rng)
        if isinstance(self.world, Columnar):
            return taken + sampling.delay, self.world.columns(taken)
        rows = [self.world.values(time) for time in taken.tolist()]
        values = {name: np.array([row[name] for row in rows], float) for name in self.spec.sensors}
        return taken + sampling.delay, values

    @property
    def notes(self) -> Sequence[str]:
        """What the world has to say."""
        return self.world.notes if isinstance(self.world, Noting) else ()

    @property
    def counters(self) -> Mapping[str, int]:
        """What the stream of samples lost, doubled and overtook."""
        present = self._arrivals.counters(self._now()) if self._arrivals else {}
        return self._past_counters + Counter(present)

    @property
    def settled(self) -> bool:
        """Whether no call hangs by an injected fault: it is not saved then."""
        return not self._hangs

    def save(self) -> Saved:
        """Return what has become of it; raise `SpecError` where its world cannot be saved."""
        if not isinstance(self.world, Saveable):
            raise SpecError(f"{type(self.world).__name__} cannot be saved: give it save and restore.")
        return {
            "first_opened": self._first_opened,
            "opened_at": self._opened_at,
            "began": self._began,
            "rng": self._drawn_from,
            "reads": self._reads,
            "due": {trouble: list(times) for trouble, times in self._due.items()},
            "past_counters": dict(self._past_counters),
            "world": self.world.save(),
        }

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, before it is opened: it then goes on from there."""
        self._begin_world(restored_stream(saved["rng"]), saved["began"])
        if isinstance(self.world, Saveable):
            self.world.restore(saved["world"])
        self._first_opened, self._goes_on_from = saved["first_opened"], saved["opened_at"]
        self._reads, self._due = saved["reads"], saved["due"]
        self._past_counters = Counter(saved["past_counters"])

    def _begin_world(self, rng: Generator, began: int | None = None) -> None:
        """Begin it, when it is prepared, or as it `began` (ns) before."""
        self._past_counters = Counter(self.counters) if self._arrivals else self._past_counters
        self._drawn_from = save_stream(rng)
        if isinstance(self.world, Preparing):
            self.world.prepare(rng)
        now = self._now() if began is None else began
        self.world.begin(now, rng)
        self._began, self._reads = now, 0
        if self._sampling.rate:
            period = 1e9 / self._sampling.rate
            self._arrivals = Arrivals(
                now,
                period,
                self._sampling.delay,
                self._sampling.jitter,
                self._faults.in_stream,
                rng.spawn(1)[0],
            )

    def _as_of_now(self) -> Sample:
        now = self._now()
        taken = now if not self._sampling.delay else max(self._began, now - self._sampling.delay)
        self._reads += 1
        return Sample(self.world.values(taken), taken, now, self._reads)

    async def _meet_troubles(self) -> None:
        if not self._opened:
            raise DisconnectedError("the device is closed: open it first.")
        if not self._troubles or self._first_opened is None:
            return
        age = self._now() - self._first_opened
        self._check_plugged(age)
        if self._comes_due("raise", age):
            raise DeviceError(f"a fault was injected at {describe(age)}")
        if self._comes_due("hang", age):
            await self._hang()

    async def _hang(self) -> None:
        self._hangs += 1
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            self._hangs -= 1

    def _comes_due(self, trouble: str, age: int) -> bool:
        due = self._due[trouble]
        if not due or age < due[0]:
            return False
        due.pop(0)
        return True

    def _check_plugged(self, age: int) -> None:
        for window in self._faults.disconnect:
            gone = age >= window[0] and (len(window) == 1 or age < window[1])
            if gone or self._opened_at < window[0] <= age:
                self._opened = False
                raise DisconnectedError("the device is unplugged")

    def _corrupted(self, values: Values, sequence: int) -> Values:
        garbage = float("nan") if sequence % 2 else 1e30
        return dict.fromkeys(values, garbage)


class LimitedFake(FakeDevice):
    """A fake of hardware whose driver brings commands within their range, as this does."""

    async def act(self, command: Command) -> Command:
        """Hand a command to the world; return what became of it."""
        return await super().act({name: self._within(name, value) for name, value in command.items()})

    def _within(self, name: str, value: Value) -> Value:
        spec = self.spec.actuators.get(name)
        if spec is None or not isinstance(value, int | float) or not isfinite(value):
            return value
        return spec.clip(value)
