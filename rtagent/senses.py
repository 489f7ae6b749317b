"""The senses: from the newest sample of every device to an observation."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from rtagent.clock import Clock
from rtagent.experience import Observation, Sample, Stimulus
from rtagent.recorder import Recorder
from rtagent.schedule import Schedule, Wait
from rtagent.supervision import NO_STIMULI, SupervisedDevice
from rtagent.units import second

NOTHING: frozenset[str] = frozenset()


class Senses:
    """Reads the devices; waits for something fresh where the schedule says so."""

    def __init__(
        self, devices: Sequence[SupervisedDevice], schedule: Schedule, clock: Clock, recorder: Recorder
    ) -> None:
        self._devices, self._clock, self._recorder = devices, clock, recorder
        self._waits = schedule.observe is Wait.FRESH
        self._timeout = schedule.observe_timeout
        self._now, self._record_age = clock.now, recorder.sample_age.record
        self._stimulating = [device for device in devices if device.stimulating]
        sampled = self._waits and all(device.device.spec.rate for device in devices)
        self.paced = bool(schedule.period) or sampled
        """Whether a cycle always waits for its time, or for a sample that comes by itself."""
        self.synchronous = any(device.device.spec.synchronous for device in devices)
        """Whether something is new only after an act."""
        specs = [device.device.spec for device in devices]
        self.as_of_now = any(not spec.rate and not spec.synchronous for spec in specs)
        """Whether an observation tells more once time has passed, without a sample that comes by itself."""
        self._may_be_stale = [device for device in devices if device.supervision.stale_after]

    async def observe(self) -> tuple[Observation, Sequence[Stimulus]]:
        """Return an observation, and the stimuli that it is the first to contain."""
        if self._waits and len(self._devices) == 1:
            device, deadline = self._devices[0], self._now() + self._timeout
            seen = device.sequence
            if not await device.wait(self._timeout):
                await self._wait_on(device, seen, deadline)
        else:
            await self._read_all()
        samples: dict[str, Sample] = {}
        for device in self._devices:
            samples[device.name] = device.sample or await device.first_sample()
        now = self._now()
        for sample in samples.values():
            self._record_age(now - sample.world_time)
        stale = self._stale(now) if self._may_be_stale else NOTHING
        return Observation(now, samples, stale), self._new_stimuli() if self._stimulating else NO_STIMULI

    async def _wait_on(self, device: SupervisedDevice, seen: int, deadline: int) -> None:
        """Wait on for as long as what comes, after the sample numbered `seen`, is not usable."""
        while seen < device.sequence and (left := deadline - self._now()) > 0:
            seen = device.sequence
            if await device.wait(left):
                return
        self._recorder.counters["observe_timeouts"] += 1

    async def _read_all(self) -> None:
        fresh = False
        for device in self._devices:
            fresh = await device.refresh() or fresh
        if self._waits and not fresh:
            deadline = self._now() + self._timeout
            while not await self._wait_for_any(deadline):
                pass

    async def _wait_for_any(self, deadline: int) -> bool:
        """Wait until some device has a new sample, at most until `deadline`; say no where it was not usable."""
        limit = max(deadline - self._now(), 0) / second
        watches = [watch for device in self._devices if (watch := device.watch()) is not None]
        if not watches:
            await asyncio.sleep(limit)
            return True
        await asyncio.wait(watches, timeout=limit, return_when=asyncio.FIRST_COMPLETED)
        seen = sum(device.sequence for device in self._devices)
        fresh = [await device.refresh() for device in self._devices if device.watched]
        if any(fresh):
            return True
        if sum(device.sequence for device in self._devices) > seen and self._now() < deadline:
            return False
        self._recorder.counters["observe_timeouts"] += 1
        return True

    # What learning asks, so that it can leave off

    def watch(self) -> None:
        """Begin to wait for new samples, so that `news` can tell of them."""
        for device in self._devices:
            device.watch()

    def news(self) -> bool:
        """Say whether there is something new to observe."""
        now = self._now()
        for device in self._devices:  # noqa: SIM110  # asked after every slice, and any() costs as much again
            if device.news(now):
                return True
        return False

    async def wait_for_news(self, other: asyncio.Future[None], at_most: int | None = None) -> None:
        """Wait until there is something new to observe, or `other` is done.

        It lasts for `at_most` (ns), without that for as long as observing may.
        """
        watches: set[asyncio.Future[Any]] = {other}
        watches |= {watch for device in self._devices if (watch := device.watch()) is not None}
        now = self._now()
        events = [event for device in self._devices if (event := device.next_news()) is not None]
        limit = max(0, min([*events, now + (self._timeout if at_most is None else at_most)]) - now)
        await asyncio.wait(watches, timeout=limit / second, return_when=asyncio.FIRST_COMPLETED)

    def observed(self) -> dict[str, Sample]:
        """Return the sample of every device that the newest observation holds."""
        return {device.name: device.sample for device in self._devices if device.sample is not None}

    async def newest(self) -> dict[str, Sample]:
        """Return the newest sample of every device that has one, also those not observed yet."""
        found = {device.name: await device.newest() for device in self._devices}
        return {name: sample for name, sample in found.items() if sample is not None}

    def _new_stimuli(self) -> Sequence[Stimulus]:
        return [stimulus for device in self._stimulating for stimulus in device.new_stimuli()]

    def _stale(self, now: int) -> frozenset[str]:
        return frozenset(device.name for device in self._may_be_stale if device.stale(now))
