"""The contract suite holds for every fake, under both clocks, and catches devices that break it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace
from math import inf

import pytest

from rtagent.clock import ClockName
from rtagent.device import Device, LastResort
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample
from rtagent.specs import DeviceSpec, Spec
from rtagent.testing import DeviceContract
from rtagent.units import ms
from rtagent_drivers.fake import Sampling
from rtagent_drivers.hallway import hallway
from rtagent_drivers.stopping import stopping_joint
from rtagent_drivers.switchboard import switchboard

MAKERS: dict[str, Callable[[], Device]] = {
    "stopping": stopping_joint,
    "stopping, sampled": lambda: stopping_joint(sampling=Sampling(rate=500.0, delay=3 * ms, jitter=ms)),
    "hallway": hallway,
    "synchronous hallway": lambda: hallway(synchronous=True),
    "switchboard": switchboard,
}
CHECKS = [name for name in vars(DeviceContract) if name.startswith("test_")]


def contract(make: Callable[[], Device], clock: ClockName = "virtual") -> DeviceContract:
    suite = DeviceContract()
    suite.make_device = make  # type: ignore[method-assign]  # as a subclass would override it
    suite.clock = clock
    suite.patience = 2.0
    return suite


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("clock", ["real", "virtual"])
@pytest.mark.parametrize("name", MAKERS)
def test_every_fake_keeps_the_contract(name: str, clock: ClockName, check: str) -> None:
    getattr(contract(MAKERS[name], clock), check)()


class Good:
    """A device that keeps the contract; each broken one below changes one thing."""

    spec = DeviceSpec(sensors={"angle": Spec(low=0.0, high=1.0)}, actuators={"speed": Spec(low=-1.0, high=1.0)})

    def __init__(self) -> None:
        self.opened = False
        self.count = 0

    async def open(self) -> None:
        self.opened = True

    async def read(self, newer_than: int) -> Sample:
        if not self.opened:
            raise DisconnectedError("closed")
        while self.count <= newer_than:
            await asyncio.sleep(0.001)
            self.count += 1
        return self.sample()

    def sample(self) -> Sample:
        now = int(asyncio.get_running_loop().time() * 1e9)
        return Sample({"angle": 0.5}, now, now, self.count)

    async def act(self, command: Command) -> Command:
        for name, value in command.items():
            if name not in self.spec.actuators:
                raise SpecError(f"no actuator {name}")
            self.spec.actuators[name].validate(value)
        return dict(command)

    async def make_safe(self) -> None:
        pass

    async def close(self) -> None:
        self.opened = False


class LacksSensor(Good):
    def sample(self) -> Sample:
        return super().sample()._replace(values={})


class OutOfRange(Good):
    def sample(self) -> Sample:
        return super().sample()._replace(values={"angle": 2.0})


class FloatTimes(Good):
    def sample(self) -> Sample:
        return super().sample()._replace(world_time=0.5)  # type: ignore[arg-type]  # the mistake to catch


class GoesBack(Good):
    sequence = 1000

    def sample(self) -> Sample:
        self.sequence -= 1
        return super().sample()._replace(sequence=self.sequence)


class DoesNotWait(Good):
    async def read(self, newer_than: int) -> Sample:
        return await super().read(-1)


class SwallowsCancellation(Good):
    async def read(self, newer_than: int) -> Sample:
        while newer_than > 1000:
            try:
                await asyncio.sleep(0.01)
            except asyncio.CancelledError:
                await asyncio.sleep(1.2)
        return await super().read(newer_than)


class SendsAnything(Good):
    async def act(self, command: Command) -> Command:
        return dict(command)


class ReturnsNothing(Good):
    async def act(self, command: Command) -> Command:
        await super().act(command)
        return {}


class UnsafeBeforeOpen(Good):
    async def make_safe(self) -> None:
        if not self.opened:
            raise RuntimeError("no port")


class ReadsWhenClosed(Good):
    async def close(self) -> None:
        pass


class OneAtATime(Good):
    def __init__(self) -> None:
        super().__init__()
        self.lock = asyncio.Lock()

    async def read(self, newer_than: int) -> Sample:
        async with self.lock:
            return await super().read(newer_than)

    async def act(self, command: Command) -> Command:
        async with self.lock:
            return await super().act(command)


class EndsReading(Good):
    acted = False

    async def read(self, newer_than: int) -> Sample:
        self.acted = False
        await asyncio.sleep(0.001)
        return self.sample() if self.acted else await super().read(newer_than)

    async def act(self, command: Command) -> Command:
        self.acted = True
        return await super().act(command)


class Hangs(Good):
    async def read(self, newer_than: int) -> Sample:
        await asyncio.sleep(3600)
        return self.sample()


class RestlessEvent(Good):
    spec = replace(Good.spec, rate=inf)
    looks = 0

    def sample(self) -> Sample:
        self.looks += 1
        return super().sample()._replace(world_time=self.looks)


class CannotBeReached(Good):
    def last_resort(self) -> LastResort:
        return LastResort("guarded:missing", {}, "")


class CountsInSeconds(Good):
    safe_within = 1.5


def test_a_device_that_keeps_the_contract_passes() -> None:
    for check in CHECKS:
        getattr(contract(Good), check)()


@pytest.mark.parametrize(
    ("broken", "check", "sentence"),
    [
        (LacksSensor, "a_sample_has_every_sensor_and_fits_its_spec", "lacks the sensors angle"),
        (OutOfRange, "a_sample_has_every_sensor_and_fits_its_spec", "outside its range"),
        (FloatTimes, "a_sample_has_every_sensor_and_fits_its_spec", "must be an int"),
        (GoesBack, "samples_never_go_back", "lower sequence number"),
        (DoesNotWait, "reading_something_newer_waits_for_it", "must wait for a higher one"),
        (SwallowsCancellation, "a_cancelled_read_does_no_harm", "went on waiting"),
        (SendsAnything, "nothing_beyond_the_limits_is_sent", "outside its range"),
        (SendsAnything, "an_unknown_actuator_is_refused", "was taken"),
        (OneAtATime, "it_acts_while_a_read_waits", "act waited for the end of a read"),
        (EndsReading, "a_read_goes_on_waiting_after_an_act", "it must go on waiting"),
        (ReturnsNothing, "act_returns_what_was_sent", "return what was sent"),
        (UnsafeBeforeOpen, "it_can_be_made_safe_at_any_time", "no port"),
        (ReadsWhenClosed, "it_can_be_closed_twice_and_opened_again", "a closed device was read"),
        (RestlessEvent, "an_event_device_tells_its_state_at_once", "another time under the same number"),
        (CannotBeReached, "it_can_be_made_safe_without_its_driver", "could not make it safe"),
        (CountsInSeconds, "its_times_are_in_nanoseconds", "safe_within is 1.5"),
        (Hangs, "a_sample_has_every_sensor_and_fits_its_spec", "did not answer within"),
    ],
)
def test_a_device_that_breaks_the_contract_is_told_how(broken: type[Good], check: str, sentence: str) -> None:
    with pytest.raises((AssertionError, SpecError, RuntimeError), match=sentence):
        getattr(contract(broken), f"test_{check}")()
