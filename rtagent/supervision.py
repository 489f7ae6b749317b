"""Supervision of devices: deadlines, a retry budget, staleness, counters, and the way to safety.

One transient error never ends a run; a dead device never hangs one.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from numpy.random import Generator

from rtagent.checkpoint.plain import restored_sample, save_sample
from rtagent.clock import Clock
from rtagent.device import Counting, Device, Episodic, Foreseeing, Stimulating
from rtagent.errors import DeviceError, DisconnectedError, LimitError, SpecError
from rtagent.events import Event, Flags
from rtagent.experience import Command, Sample, Stimulus
from rtagent.guard import HangGuard
from rtagent.health import FIRST_PAUSE, LONGEST_PAUSE, Health, Validity
from rtagent.latch import Latch
from rtagent.saving import Saveable, Saved
from rtagent.specs import DeviceSpec
from rtagent.units import describe, ms, second

OPEN_TIMEOUT = 10 * second
BEGIN_TIMEOUT = 60 * second
"""Going to the start of an episode may be a slow move of a real arm."""
JUST_NOW = 1 * ms
"""A sample that arrived no longer ago is the newest, or the next follows at once."""
NO_STIMULI: Sequence[Stimulus] = ()


@dataclass(frozen=True)
class Supervision:
    """How patient the runtime is with a device; times in ns.

    `timeout` is the retry budget: how long calls may fail or hang before the run is ended safely. A sample
    older than `stale_after` is marked stale in the observation (0: never). `events` are flags that are added to
    the device's sensors, by their names.
    """

    timeout: int = 500 * ms
    stale_after: int = 0
    events: Mapping[str, Event] = field(default_factory=dict)

    def spec_of(self, device: Device) -> DeviceSpec:
        """Return what is sensed of `device`, events included; raise `SpecError` for events that do not fit it."""
        return Flags(self.events, device.spec).spec


class DeadDeviceError(DeviceError):
    """A device failed for longer than its retry budget."""


class SupervisedDevice:
    """A device with its newest valid sample, its counters, and its health."""

    def __init__(
        self,
        name: str,
        device: Device,
        supervision: Supervision,
        clock: Clock,
        guard: HangGuard,
        latch: Latch,
        report: Callable[[str, str], None],
        reopened: Callable[[], Awaitable[None]],
    ) -> None:
        self.name, self.device, self.supervision = name, device, supervision
        self._clock, self._guard, self._report = clock, guard, report
        self._reopened = reopened
        self._reading, self._acting = f"{name}.read", f"{name}.act"
        self._latch, self._stopped = latch, latch.memory
        validity = Validity(device.spec)
        self._valid, self._why_invalid = validity.holds, validity.why_not
        self._flags = Flags(supervision.events, device.spec) if supervision.events else None
        self._stimulating = device if isinstance(device, Stimulating) else None
        self._foreseeing = device if isinstance(device, Foreseeing) else None
        self._counts: Counter[str] = Counter()
        self._reads, self._acts = Health(supervision.timeout), Health(supervision.timeout)
        self._troubled = False
        self._reopening: asyncio.Task[None] | None = None
        self.sample: Sample | None = None
        self.sequence = -1
        self._observed: Sample | None = None
        self._seen = -1
        self._stimuli_until = 0
        self.as_of_now = not device.spec.rate
        self._watching: asyncio.Future[Sample] | None = None
        self._watch_ends = 0

    @property
    def stimulating(self) -> bool:
        """Whether the device knows when stimuli happen."""
        return self._stimulating is not None or self._flags is not None

    @property
    def surprising(self) -> bool:
        """Whether it has new samples by itself, nobody knows when."""
        return self._foreseeing is None and not self.as_of_now

    async def open(self) -> None:
        """Open the device; raises what it raises, or TimeoutError."""
        await self._guard.bound(self.device.open(), OPEN_TIMEOUT, f"{self.name}.open")

    async def go_to_start(self, rng: Generator) -> None:
        """Bring it to the start of an episode; raise `StoppedError` once the run is stopped."""
        self.stop_watching()
        if isinstance(self.device, Episodic):
            self._latch.check()
            await self._guard.bound(self.device.begin_episode(rng), BEGIN_TIMEOUT, f"{self.name}.begin_episode")

    def begin_episode(self, time: int) -> None:
        """Forget the samples of before `time`, when the device was brought to the start of an episode."""
        self.sample = self._observed = None
        self.sequence = self._seen = -1
        self._stimuli_until = time - 1
        if self._flags is not None:
            self._flags.begin()

    async def read(self, newer_than: int, limit: int = 0) -> bool:
        """Read the newest sample, within `limit` (ns; 0: what is left of the budget); say whether it is a new one.

        Errors are counted; raises `DeadDeviceError`.
        """
        reads = self._reads
        if self._troubled and not self._may_call(reads):
            return False
        self._guard.arm(limit or self._budget(reads), self._reading)
        try:
            sample = await self.device.read(newer_than)
        except BaseException as error:
            self._failed("read", reads, self._guard.explained(error))
            return False
        finally:
            self._guard.disarm()
        if self._troubled:
            self._recovered(reads)
        return self._accept(sample)

    async def first_sample(self) -> Sample:
        """Wait for the first valid sample: nothing is chosen, and nothing moves, before it."""
        deadline = self._clock.now() + self.supervision.timeout
        while self.sample is None:
            left = deadline - self._clock.now()
            if left <= 0:
                raise DeviceError(
                    f"device {self.name!r} gave no valid sample within {describe(self.supervision.timeout)}, "
                    "and nothing moves before it: check its connection, or give it a longer timeout."
                )
            await self.wait(left)
        return self.sample

    # Watching: a reading that waits for the next sample while something else is done

    def watch(self) -> asyncio.Future[Sample] | None:
        """Begin to wait for a new sample, unless that is going on; return what waits (None: nothing can)."""
        if self._watching is None and not self.as_of_now and not self.failing:
            self._watching = asyncio.ensure_future(self.device.read(self._seen))
            self._watch_ends = self._clock.now() + self.supervision.timeout // 2
        return self._watching

    def news(self, now: int) -> bool:
        """Say whether a new sample has come, or the world has changed, or it is time to see to the device."""
        if self._watching is not None:
            return self._watching.done() or now >= self._watch_ends
        event = self.next_news()
        return event is not None and now >= event

    def next_news(self) -> int | None:
        """Return when (ns) there will be something new that does not come by itself; None for never, or unknown.

        A device that is read as of now has always something new, unless it is a fake that foresees its changes.
        """
        if self.failing:
            return self._reads.retry_at
        if not self.as_of_now or self._observed is None:
            return None
        if self._foreseeing is not None:
            return self._foreseeing.next_event(self._observed.arrival_time)
        return None if self.device.spec.synchronous else self._observed.arrival_time

    async def newest(self) -> Sample | None:
        """Return the newest sample there is; it is not observed yet."""
        if self.as_of_now or (self._watching is not None and self._watching.done()):
            await self.read(-1)
        return self.sample

    @property
    def watched(self) -> bool:
        """Whether something waits for the next sample, or has found it."""
        return self._watching is not None

    def stop_watching(self) -> None:
        """Give up waiting for the next sample."""
        watching, self._watching = self._watching, None
        if watching is not None and not watching.cancel() and not watching.cancelled():
            watching.exception()  # seen: nobody else will ask for it

    async def refresh(self) -> bool:
        """Observe the newest sample; say whether it is new."""
        watching = self._watching
        if watching is None:
            await self.read(-1)
        elif watching.done():
            self._watching = None
            self._take(watching)
            if self.sample is None or self._clock.now() - self.sample.arrival_time > JUST_NOW:
                await self.read(-1)  # what the watch found may have been followed by others
        elif self._clock.now() >= self._watch_ends:
            await self._examine()
        return self._observe()

    async def wait(self, limit: int) -> bool:
        """Wait at most `limit` (ns) for a new sample, and observe it; say whether there is one."""
        at_rest = self._watching is None and self._reads.failing_since is None
        if not at_rest or self.sample is not self._observed:
            return await self._wait_otherwise(limit)
        self._guard.arm(limit, self._reading)
        try:
            sample = await self.device.read(self._seen)
        except BaseException as error:
            failure = self._guard.explained(error)
        else:
            if not self._accept(sample):
                return self._observe()
            self._observed, self._seen = self.sample, sample.sequence  # what _observe does, at each step of a run
            return True
        finally:
            self._guard.disarm()
        if isinstance(failure, TimeoutError):
            await self.read(-1)
        else:
            self._failed("read", self._reads, failure)
        return self._observe()

    async def _wait_otherwise(self, limit: int) -> bool:
        """Wait where something waits already, was read and not observed, or fails."""
        if self._watching is not None and not self._watching.done():
            if self._clock.now() >= self._watch_ends:
                await self._examine()
            else:
                await asyncio.wait({self._watching}, timeout=limit / second)
                if not self._watching.done():
                    self.stop_watching()
                return await self.refresh()
        if self._watching is not None or self.sample is not self._observed:
            return await self.refresh()
        if not self.failing:
            return await self.wait(limit)
        now = self._clock.now()
        await self._clock.sleep_until(min(max(self._reads.retry_at, now + FIRST_PAUSE), now + limit))
        await self.read(-1)
        return self._observe()

    async def _examine(self) -> None:
        """End a watch that has gone on for half of the retry budget; a device that hangs answers no read either."""
        self.stop_watching()
        await self.read(-1, self.supervision.timeout // 2)

    def _observe(self) -> bool:
        """Note that the newest sample is observed; say whether it is new."""
        new = self.sample is not self._observed
        self._observed, self._seen = self.sample, self.sequence
        return new

    def _take(self, reading: asyncio.Future[Sample]) -> None:
        """Take the sample of a finished reading."""
        error = reading.exception()
        if error is None:
            self._accept(reading.result())
        elif isinstance(error, Exception):
            self._failed("read", self._reads, error)

    @property
    def failing(self) -> bool:
        """Whether the last read failed."""
        return self._reads.failing_since is not None

    async def act(self, command: Command) -> Command | None:
        """Send a command; return what was sent, or None where it could not be (counted).

        Raises `StoppedError` once the run is stopped.
        """
        if self._stopped[0]:
            raise self._latch.error()
        acts = self._acts
        if not self._troubled or self._may_call(acts):
            self._guard.arm(self._budget(acts), self._acting)
            try:
                sent = await self.device.act(command)
            except BaseException as error:
                self._failed("act", acts, self._guard.explained(error))
            else:
                if self._troubled:
                    self._recovered(acts)
                return sent
            finally:
                self._guard.disarm()
        self._counts["commands_not_sent"] += 1
        return None

    def stale(self, now: int) -> bool:
        """Say whether the newest sample is older than declared, and count it if so."""
        limit = self.supervision.stale_after
        if not limit or self.sample is None or now - self.sample.world_time <= limit:
            return False
        self._counts["stale"] += 1
        return True

    def new_stimuli(self, until: int | None = None) -> Sequence[Stimulus]:
        """Return the stimuli up to the newest sample (or up to `until`, ns) that were not returned before."""
        if self.sample is None:
            return NO_STIMULI
        after = self._stimuli_until
        end = self.sample.world_time if until is None else until
        if end <= after:
            return NO_STIMULI
        self._stimuli_until = end
        own = self._stimulating.stimuli(after, end) if self._stimulating is not None else NO_STIMULI
        return own if self._flags is None else sorted([*own, *self._flags.stimuli(after, end)])

    def next_event(self, now: int) -> int | None:
        """Return when a fake changes next, or when a failing device is tried again; None for never."""
        retries = [each.retry_at for each in (self._reads, self._acts) if each.failing_since is not None]
        if retries:
            return max(min(retries), now + FIRST_PAUSE)
        return self._foreseeing.next_event(now) if self._foreseeing else None

    async def make_safe(self) -> None:
        """Make the device safe; raises what it raises."""
        self.stop_watching()
        self.stop_reopening()
        await self.device.make_safe()

    def stop_reopening(self) -> None:
        """Give up opening the device anew."""
        if self._reopening is not None:
            self._reopening.cancel()

    @property
    def counters(self) -> Mapping[str, int]:
        """What was dropped, retried, late or damaged, as far as it happened."""
        own = self.device.counters if isinstance(self.device, Counting) else {}
        return {name: count for name, count in (Counter(own) + self._counts).items() if count}

    # What a checkpoint keeps of it

    @property
    def settled(self) -> bool:
        """Whether nothing fails, or hangs, or is being opened anew: only then is it saved."""
        watching = self._watching
        failed = watching is not None and watching.done() and watching.exception() is not None
        return not (self._troubled or failed) and getattr(self.device, "settled", True)

    def save(self) -> Saved:
        """Return what it is at and what was counted; raise `SpecError` where the device cannot be saved."""
        if not isinstance(self.device, Saveable):
            raise SpecError(
                f"the device {self.name!r} cannot be saved in the middle of a run under the virtual clock: "
                "give its driver save and restore (docs/checkpoints.md)."
            )
        return {
            "device": self.device.save(),
            "counts": dict(self._counts),
            "flags": None if self._flags is None else self._flags.save(),
            "sample": save_sample(self.sample),
            "observed": self.sample is self._observed or save_sample(self._observed),
            "sequence": self.sequence,
            "seen": self._seen,
            "stimuli_until": self._stimuli_until,
            "watching": self._save_watching(),
        }

    def restore_device(self, saved: Saved) -> None:
        """Have the device, which is not open yet, go on from where it was."""
        if isinstance(self.device, Saveable):
            self.device.restore(saved["device"])
        self._counts = Counter(saved["counts"])

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned in the middle of an episode; the device is open."""
        if self._flags is not None:
            self._flags.restore(saved["flags"])
        self.sample, observed = restored_sample(saved["sample"]), saved["observed"]
        self._observed = self.sample if observed is True else restored_sample(observed)
        self.sequence, self._seen = saved["sequence"], saved["seen"]
        self._stimuli_until = saved["stimuli_until"]
        self._restore_watching(saved["watching"])

    def _save_watching(self) -> Saved | None:
        watching = self._watching
        if watching is None:
            return None
        found = watching.result() if watching.done() and watching.exception() is None else None
        return {"ends": self._watch_ends, "found": save_sample(found)}

    def _restore_watching(self, saved: Saved | None) -> None:
        if saved is None:
            return
        found = restored_sample(saved["found"])
        if found is None:
            self._watching = asyncio.ensure_future(self.device.read(self._seen))
        else:
            self._watching = asyncio.get_running_loop().create_future()
            self._watching.set_result(found)
        self._watch_ends = saved["ends"]

    def _budget(self, calls: Health) -> int:
        """Return how long (ns) a call may take: what is left of the retry budget."""
        timeout = self.supervision.timeout
        if calls.failing_since is None:
            return timeout
        return max(timeout - calls.spent(self._clock.now()), FIRST_PAUSE)

    def _may_call(self, calls: Health) -> bool:
        """Say whether such a call may be made; raise `DeadDeviceError` where either kind has used up its budget."""
        now = self._clock.now()
        for each in (self._reads, self._acts):
            if each.spent(now) >= self.supervision.timeout:
                raise DeadDeviceError(
                    f"device {self.name!r} has not answered for {describe(each.spent(now))}, "
                    f"its retry budget is {describe(self.supervision.timeout)}; last error: {each.last_error}."
                )
        if calls.failing_since is None:
            return True
        if self._reopening is not None and not self._reopening.done():
            return False
        if now < calls.retry_at:
            return False
        self._counts["retries"] += 1
        return True

    def _recovered(self, calls: Health) -> None:
        calls.failing_since = None
        self._troubled = any(each.failing_since is not None for each in (self._reads, self._acts))

    def _failed(self, verb: str, calls: Health, error: Exception) -> None:
        said = f"{verb} raised {error!r}"
        self._counts[f"{verb}_errors"] += 1
        self._report(self.name, said)
        if isinstance(error, LimitError):
            raise error
        calls.failed(self._clock.now(), said, hung=isinstance(error, TimeoutError))
        self._troubled = True
        if isinstance(error, DisconnectedError) and (self._reopening is None or self._reopening.done()):
            self._reopening = asyncio.get_running_loop().create_task(self._reopen())

    async def _reopen(self) -> None:
        pause = FIRST_PAUSE
        while True:
            await self._clock.sleep_until(self._clock.now() + pause)
            pause = min(2 * pause, LONGEST_PAUSE)
            with contextlib.suppress(Exception):
                await self.device.close()
                await self.device.open()
                await self._reopened()
                self._counts["reopened"] += 1
                return

    def _accept(self, sample: Sample) -> bool:
        if sample.sequence <= self.sequence:
            return False
        self.sequence = sample.sequence
        if not self._valid(sample.values):
            self._counts["invalid_samples"] += 1
            self._report(self.name, self._why_invalid(sample.values))
            return False
        self.sample = sample if self._flags is None else self._flags(sample)
        return True
