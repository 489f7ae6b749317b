"""For authors of drivers: a suite of tests that holds a device to its contract, failing with sentences.

from rtagent.testing import DeviceContract

class TestMyDevice(DeviceContract):
    def make_device(self):
        return MyDevice("/dev/ttyUSB0")
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Coroutine
from math import isinf
from typing import Any

import numpy as np

from rtagent import clock
from rtagent.clock import ClockName
from rtagent.device import Device, Episodic, Foreseeing, Guarded, Stimulating
from rtagent.errors import DeviceError, RtagentError
from rtagent.experience import Command, Sample
from rtagent.specs import DeviceSpec, Spec
from rtagent.watchdog.resorts import Resort

FUTURE = 50_000_000
"""Stamps of a kernel or a device may lie this much (ns) in the future."""


def must(condition: bool, sentence: str) -> None:
    """Raise AssertionError with a sentence unless `condition` holds."""
    if not condition:
        raise AssertionError(sentence)


class DeviceContract:
    """Tests that every device passes, hardware and fakes alike. Override `make_device`.

    `clock` is the clock to test under. No test may take longer than `patience` seconds.
    """

    clock: ClockName = "real"
    patience = 10.0

    def make_device(self) -> Device:
        """Return a new device, not yet open."""
        raise AssertionError("override make_device: return a new device, not yet open.")

    def test_its_spec_describes_it(self) -> None:
        """Its spec is there before it is opened."""
        spec = self.make_device().spec
        must(isinstance(spec, DeviceSpec), f"spec is {spec!r}: it must be a DeviceSpec, before open already.")
        for name, each in [*spec.sensors.items(), *spec.actuators.items()]:
            must(isinstance(each, Spec), f"the spec of {name!r} is {each!r}: it must be a Spec.")

    def test_a_sample_has_every_sensor_and_fits_its_spec(self) -> None:
        """Samples are complete and valid."""

        async def check(device: Device) -> None:
            _check_sample(device, await device.read(-1))

        self._with_open_device(check)

    def test_samples_never_go_back(self) -> None:
        """Sequence numbers and times do not decrease."""

        async def check(device: Device) -> None:
            last = await device.read(-1)
            for _ in range(20):
                sample = await device.read(-1)
                must(sample.sequence >= last.sequence, "a later read returned a lower sequence number.")
                must(sample.world_time >= last.world_time, "a later read returned an earlier world_time.")
                last = sample

        self._with_open_device(check)

    def test_reading_something_newer_waits_for_it(self) -> None:
        """`read(newer_than)` returns a sample above that number."""

        async def check(device: Device) -> None:
            if isinf(device.spec.rate):
                return
            last = await device.read(-1)
            for _ in range(3):
                sample = await device.read(last.sequence)
                must(
                    sample.sequence > last.sequence,
                    f"read({last.sequence}) returned number {sample.sequence}: it must wait for a higher one.",
                )
                _check_sample(device, sample)
                last = sample

        self._with_open_device(check)

    def test_an_event_device_tells_its_state_at_once(self) -> None:
        """Where `spec.rate` is `math.inf`, `read(-1)` never waits, and repeats a state under its own number."""

        async def check(device: Device) -> None:
            if not isinf(device.spec.rate):
                return
            first, again = await device.read(-1), await device.read(-1)
            must(
                again.sequence > first.sequence or again.world_time == first.world_time,
                "a state was read twice and got another time under the same number.",
            )

        self._with_open_device(check)

    def test_a_cancelled_read_does_no_harm(self) -> None:
        """A read that is given up leaves the device usable."""

        async def check(device: Device) -> None:
            last = await device.read(-1)
            reading = asyncio.ensure_future(device.read(last.sequence + 1_000_000))
            await asyncio.sleep(0)
            reading.cancel()
            done, _ = await asyncio.wait({reading}, timeout=1.0)
            must(bool(done), "a read that was cancelled went on waiting: let CancelledError through.")
            _check_sample(device, await device.read(-1))

        self._with_open_device(check)

    def test_it_acts_while_a_read_waits(self) -> None:
        """`act` works while a `read` waits for a newer sample."""

        async def check(device: Device) -> None:
            rng, last = np.random.default_rng(2), await device.read(-1)
            reading = asyncio.ensure_future(device.read(last.sequence + 1_000_000))
            for name, spec in device.spec.actuators.items():
                command = {name: spec.generate(rng)}
                acting = asyncio.ensure_future(device.act(command))
                done, _ = await asyncio.wait({acting}, timeout=1.0)
                must(bool(done), "act waited for the end of a read that waits for a newer sample.")
                _check_sent(device, command, acting.result())
            reading.cancel()
            await asyncio.wait({reading}, timeout=1.0)

        self._with_open_device(check)

    def test_a_read_goes_on_waiting_after_an_act(self) -> None:
        """A `read` that waited for a newer sample while the device acted still returns one."""

        async def check(device: Device) -> None:
            if isinf(device.spec.rate):
                return
            rng, last = np.random.default_rng(3), await device.read(-1)
            for name, spec in device.spec.actuators.items():
                reading = asyncio.ensure_future(device.read(last.sequence))
                await asyncio.sleep(0)
                await device.act({name: spec.generate(rng)})
                sample = await reading
                must(
                    sample.sequence > last.sequence,
                    f"read({last.sequence}) returned number {sample.sequence} after an act: it must go on waiting.",
                )
                _check_sample(device, sample)
                last = sample

        self._with_open_device(check)

    def test_act_returns_what_was_sent(self) -> None:
        """A valid command is taken, and what was sent lies within the limits."""

        async def check(device: Device) -> None:
            rng = np.random.default_rng(1)
            for name, spec in device.spec.actuators.items():
                for _ in range(3):
                    command = {name: spec.generate(rng)}
                    _check_sent(device, command, await device.act(command))

        self._with_open_device(check)

    def test_nothing_beyond_the_limits_is_sent(self) -> None:
        """A command outside its range is limited or refused, and one that is no number is refused."""

        async def check(device: Device) -> None:
            for name, spec in device.spec.actuators.items():
                outside = [value for value in (spec.low - 1.0, spec.high + 1.0) if np.isfinite(value)]
                for value in [*outside, float("nan")]:
                    command: Command = {name: value if not spec.shape else np.full(spec.shape, value)}
                    await _check_limited(device, command)

        self._with_open_device(check)

    def test_an_unknown_actuator_is_refused(self) -> None:
        """A command for an actuator that is not there raises an error of rtagent."""

        async def check(device: Device) -> None:
            try:
                await device.act({"no such actuator": 0.0})
            except RtagentError:
                return
            raise AssertionError("a command for an actuator that is not there was taken: raise SpecError.")

        self._with_open_device(check)

    def test_it_can_be_made_safe_at_any_time(self) -> None:
        """`make_safe` works before open, twice, and after close."""

        async def check(device: Device) -> None:
            await device.make_safe()
            await device.open()
            await device.make_safe()
            await device.make_safe()
            await device.close()
            await device.make_safe()

        self._run(check)

    def test_it_can_be_closed_twice_and_opened_again(self) -> None:
        """`close` may be repeated; reads of a closed device raise; it can be opened again."""

        async def check(device: Device) -> None:
            await device.open()
            await device.close()
            await device.close()
            try:
                await device.read(-1)
            except DeviceError:
                pass
            else:
                raise AssertionError("a closed device was read: raise DisconnectedError.")
            await device.open()
            _check_sample(device, await device.read(-1))
            await device.close()

        self._run(check)

    def test_an_episode_begins_with_samples_of_its_own(self) -> None:
        """After `begin_episode` no sample is from before it."""

        async def check(device: Device) -> None:
            if not isinstance(device, Episodic):
                return
            for seed in range(2):
                began = clock.current().now()
                await device.begin_episode(np.random.default_rng(seed))
                sample = await device.read(-1)
                must(
                    sample.world_time >= began,
                    "the first sample after begin_episode is from before it: wait for one of the new episode.",
                )

        self._with_open_device(check)

    def test_stimuli_lie_in_the_asked_interval(self) -> None:
        """`stimuli(after, until)` returns those with after < time <= until, in order, the same each time."""

        async def check(device: Device) -> None:
            if not isinstance(device, Stimulating):
                return
            began = clock.current().now()
            until = began + 60_000_000_000
            found = list(device.stimuli(began, until))
            must(
                found == list(device.stimuli(began, until)),
                "stimuli() returned something else when asked again.",
            )
            times = [stimulus.time for stimulus in found]
            must(times == sorted(times), "stimuli() are not in the order of their times.")
            must(all(began < time <= until for time in times), "stimuli() returned one outside the interval.")

        self._with_open_device(check)

    def test_what_it_foresees_lies_ahead(self) -> None:
        """`next_event(now)` is after now, or None."""

        async def check(device: Device) -> None:
            if isinstance(device, Foreseeing):
                now = clock.current().now()
                event = device.next_event(now)
                must(event is None or event > now, f"next_event({now}) returned {event}, which is not ahead.")

        self._with_open_device(check)

    def test_it_can_be_made_safe_without_its_driver(self) -> None:
        """The last resort of a guarded device works beside its driver, and leaves it usable."""

        async def check(device: Device) -> None:
            if not isinstance(device, Guarded):
                return
            told = device.last_resort()
            must(isinstance(told.hardware, str), "last_resort.hardware must be a name, or empty.")
            settings = json.loads(json.dumps(dict(told.settings)))
            resort = Resort("device", told.function, settings)
            for _ in range(2):
                not_safe = await asyncio.to_thread(resort.make_safe)
                must(not not_safe, f"its last resort could not make it safe: {' '.join(not_safe)}")
            resort.close()
            _check_sample(device, await _read_at_last(device))

        self._with_open_device(check)

    def test_its_times_are_in_nanoseconds(self) -> None:
        """`safe_within` and `tolerates`, where it has them, are whole numbers of nanoseconds."""
        device = self.make_device()
        for name in ("safe_within", "tolerates"):
            value = getattr(device, name, 0)
            must(isinstance(value, int) and value >= 0, f"{name} is {value!r}: it must be an int (ns), 0 or more.")

    def _with_open_device(self, check: Callable[[Device], Coroutine[Any, Any, None]]) -> None:
        async def opened(device: Device) -> None:
            await device.open()
            try:
                await check(device)
            finally:
                await device.close()

        self._run(opened)

    def _run(self, check: Callable[[Device], Coroutine[Any, Any, None]]) -> None:
        async def bounded() -> None:
            try:
                async with asyncio.timeout(self.patience):
                    await check(self.make_device())
            except TimeoutError:
                raise AssertionError(
                    f"the device did not answer within {self.patience:g} s: every call must return or raise, "
                    "and let itself be cancelled."
                ) from None

        clock.run(bounded(), self.clock)


async def _read_at_last(device: Device) -> Sample:
    """Return a sample of a device that may have failed meanwhile, and is tried again as a run tries it."""
    while True:
        try:
            return await device.read(-1)
        except DeviceError:
            await asyncio.sleep(0.01)


def _check_sample(device: Device, sample: Sample) -> None:
    sensors = device.spec.sensors
    missing, extra = (
        sorted(sensors.keys() - sample.values.keys()),
        sorted(sample.values.keys() - sensors.keys()),
    )
    must(not missing, f"a sample lacks the sensors {', '.join(missing)} that the spec declares.")
    must(not extra, f"a sample holds {', '.join(extra)}, which the spec does not declare.")
    for name, spec in sensors.items():
        spec.validate(sample.values[name], f"sensor {name!r}")
    for field in ("world_time", "arrival_time", "sequence"):
        value = getattr(sample, field)
        must(isinstance(value, int), f"{field} of a sample is {value!r}: it must be an int (times in ns).")
    must(sample.sequence >= 0, f"a sample has the sequence number {sample.sequence}: it must be 0 or more.")
    now = clock.current().now()
    must(
        sample.arrival_time <= now + FUTURE,
        "arrival_time of a sample lies in the future: use the loop's clock.",
    )
    must(sample.world_time <= sample.arrival_time + FUTURE, "a sample arrived before it was taken.")


def _check_sent(device: Device, command: Command, sent: Command) -> None:
    must(
        isinstance(sent, dict) and sent.keys() == command.keys(),
        f"act({dict(command)!r}) returned {sent!r}: return what was sent, a value for each actuator named.",
    )
    for name, value in sent.items():
        device.spec.actuators[name].validate(value, f"what act() returned for {name!r}")


async def _check_limited(device: Device, command: Command) -> None:
    try:
        sent = await device.act(command)
    except RtagentError:
        return
    _check_sent(device, command, sent)
