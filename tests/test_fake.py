"""Fakes: what a device reads, when, and what goes wrong on demand."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

import numpy as np
import pytest
from helpers import RampWorld, Scripted, virtually
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator

from rtagent import Sample, clock, ms, second
from rtagent.clock import current
from rtagent.errors import DeviceError, DisconnectedError, SpecError
from rtagent_drivers.fake import FakeDevice, Faults, Sampling

RATE, PERIOD, DELAY = 100.0, 10 * ms, 3 * ms


def now() -> int:
    return current().now()


def fake(
    rate: float = RATE, delay: int = DELAY, jitter: int = 0, world: RampWorld | None = None, **faults: object
) -> FakeDevice:
    return FakeDevice(world or RampWorld(), Sampling(rate, delay, jitter), Faults(**faults))  # type: ignore[arg-type]  # the names are those of Faults


def rng(seed: int = 0) -> Generator:
    return np.random.default_rng(seed)


async def opened(device: FakeDevice, generator: Generator | None = None) -> int:
    """Open a device and begin an episode; return when that was."""
    await device.open()
    await device.begin_episode(generator or rng())
    return now()


def age(sample: Sample) -> float:
    value = sample.values["age"]
    assert isinstance(value, float)
    return value


async def read_all(device: FakeDevice, until: int) -> list[Sample]:
    """Read every sample that can be had until a time."""
    samples: list[Sample] = []
    try:
        async with asyncio.timeout((until - now()) / 1e9):
            while True:
                samples.append(await device.read(samples[-1].sequence if samples else -1))
    except TimeoutError:
        return samples


# Sampling


@given(st.integers(0, second), st.integers(0, 50 * ms))
@settings(max_examples=40)
def test_without_a_rate_a_world_is_read_as_of_now_less_the_way_to_the_host(wait: int, delay: int) -> None:
    async def main() -> None:
        device = fake(rate=0.0, delay=delay)
        began = await opened(device)
        await current().compute(wait)
        sample = await device.read(-1)
        assert sample.arrival_time == now() == began + wait
        assert sample.world_time == max(began, began + wait - delay)
        assert age(sample) == sample.world_time - began
        assert (await device.read(sample.sequence)).sequence > sample.sequence

    virtually(main())


@given(st.lists(st.integers(0, 60 * ms), min_size=1, max_size=8), st.sampled_from([0, DELAY, 25 * ms]))
@settings(max_examples=60)
def test_after_a_busy_time_the_newest_sample_is_the_one_that_a_buffer_would_hold(
    busy: list[int], delay: int
) -> None:
    async def main() -> None:
        device = fake(delay=delay)
        began = await opened(device)
        await current().compute(delay)
        for cost in busy:
            await current().compute(cost)
            asked = now()
            sample = await device.read(-1)
            number = (asked - delay - began) // PERIOD
            taken = began + number * PERIOD
            assert sample == Sample({"age": float(number * PERIOD)}, taken, taken + delay, number)
            assert now() == asked

    virtually(main())


@given(st.integers(0, 60 * ms), st.integers(-1, 8))
@settings(max_examples=60)
def test_a_read_waits_until_a_sample_is_newer_and_no_longer(busy: int, newer_than: int) -> None:
    async def main() -> None:
        device = fake()
        began = await opened(device)
        await current().compute(busy)
        asked = now()
        sample = await device.read(newer_than)
        there = (asked - began - DELAY) // PERIOD
        assert sample.sequence == max(there, newer_than + 1)
        assert now() == max(asked, began + sample.sequence * PERIOD + DELAY)

    virtually(main())


@given(st.lists(st.integers(0, 35 * ms), max_size=8), st.integers(0, 2**32))
@settings(max_examples=40)
def test_what_is_read_at_a_time_does_not_depend_on_what_was_read_before(busy: list[int], seed: int) -> None:
    def device() -> FakeDevice:
        return fake(jitter=25 * ms, drop=0.2, duplicate=0.2, corrupt=0.2, late=0.2, lateness=40 * ms)

    async def main() -> None:
        curious, lazy = device(), device()
        await opened(curious, rng(seed))
        await opened(lazy, rng(seed))
        for cost in busy:
            await curious.read(-1)
            await current().compute(cost)
        assert repr(await curious.read(-1)) == repr(await lazy.read(-1))
        assert curious.counters == lazy.counters

    virtually(main())


def test_jitter_delays_each_sample_by_its_own_and_no_more_than_declared() -> None:
    async def main() -> None:
        device = fake(jitter=8 * ms)
        began = await opened(device)
        samples = await read_all(device, began + 2 * second)
        late = [sample.arrival_time - sample.world_time - DELAY for sample in samples]
        assert len(samples) > 150
        assert 0 <= min(late) < ms
        assert 7 * ms < max(late) <= 8 * ms
        assert len(set(late)) > 100

    virtually(main())


def test_a_cancelled_read_leaves_the_device_as_it_was() -> None:
    async def main() -> int:
        device = fake()
        await opened(device)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.001):
                await device.read(5)
        return (await device.read(5)).sequence

    assert virtually(main()) == 6


def test_an_episode_begins_with_a_world_and_samples_of_its_own() -> None:
    async def main() -> None:
        device = fake()
        await opened(device)
        await asyncio.sleep(0.5)
        began = await opened(device)
        sample = await device.read(-1)
        assert (sample.sequence, sample.world_time, age(sample)) == (0, began, 0.0)

    virtually(main())


def test_a_device_that_is_opened_again_goes_on() -> None:
    async def main() -> float:
        device = fake()
        began = await opened(device)
        await device.close()
        await device.close()
        await asyncio.sleep(0.5)
        await device.open()
        return age(await device.read(-1)) / (now() - began)

    assert 0.9 < virtually(main()) <= 1


def test_a_blocked_loop_misses_nothing_of_the_world_in_real_time() -> None:
    async def main() -> tuple[int, int]:
        device = fake(rate=1000.0, delay=0)
        await opened(device)
        await current().compute(30 * ms)
        sample = await device.read(-1)
        assert isinstance(device.world, RampWorld)
        return sample.world_time - device.world.began[-1], sample.sequence

    world_time, sequence = clock.run(main(), "real")
    # 30 periods of 1 ms have passed, though the loop never ran
    assert sequence >= 30
    assert world_time == sequence * ms


# Commands, stimuli, events


def test_a_command_reaches_the_world_when_it_is_sent_and_what_became_of_it_is_returned() -> None:
    async def main() -> None:
        world = RampWorld()
        device = fake(world=world)
        await opened(device)
        await asyncio.sleep(0.0123)
        assert await device.act({"power": 0.5}) == {"power": 0.5}
        assert world.commands == [(now(), {"power": 0.5})]

    virtually(main())


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ({"force": 1.0}, "no actuator 'force'; this device has power"),
        ({"power": 2.0}, "power: 2.0 is outside its range"),
        ({"power": math.nan}, "not finite"),
        ({"power": "full"}, "not a number"),
    ],
)
def test_a_bad_command_is_refused_with_a_sentence_and_does_not_reach_the_world(
    command: dict[str, float], sentence: str
) -> None:
    world = RampWorld()

    async def main() -> None:
        device = fake(world=world)
        await opened(device)
        with pytest.raises(SpecError, match=sentence):
            await device.act(command)

    virtually(main())
    assert world.commands == []


def test_a_device_that_is_not_open_says_so() -> None:
    async def main() -> None:
        device = fake()
        for attempt in (lambda: device.read(-1), lambda: device.act({"power": 0.0})):
            with pytest.raises(DisconnectedError, match="open it first"):
                await attempt()
        await device.make_safe()
        await device.close()

    virtually(main())


def test_an_episode_of_a_device_that_is_not_open_cannot_begin() -> None:
    async def main() -> None:
        with pytest.raises(DisconnectedError):
            await fake().begin_episode(rng())

    virtually(main())


def test_a_device_is_made_safe_now() -> None:
    async def main() -> None:
        world = RampWorld()
        device = fake(world=world)
        await opened(device)
        await asyncio.sleep(0.1)
        await device.make_safe()
        await device.make_safe()
        assert world.safe == [now(), now()]

    virtually(main())


def test_stimuli_are_those_of_the_world() -> None:
    async def main() -> None:
        device = fake(world=RampWorld(changes=[10, 20, 30]))
        began = await opened(device)
        assert [stimulus.time - began for stimulus in device.stimuli(began + 10, began + 30)] == [20, 30]

    virtually(main())


def test_the_next_event_is_an_arrival_where_there_are_samples_else_a_change_as_it_will_be_seen() -> None:
    async def main() -> None:
        sampled = fake(world=RampWorld(changes=[15 * ms]))
        began = await opened(sampled)
        assert sampled.next_event(began) == began + DELAY
        assert sampled.next_event(began + DELAY) == began + PERIOD + DELAY
        delayed = fake(rate=0.0, world=RampWorld(changes=[15 * ms]))
        began = await opened(delayed)
        seen = began + 15 * ms + DELAY
        assert delayed.next_event(began) == delayed.next_event(seen - 1) == seen
        assert delayed.next_event(seen) is None
        await current().sleep_until(seen - 1)
        assert age(await delayed.read(-1)) < 15 * ms
        await current().sleep_until(seen)
        assert age(await delayed.read(-1)) == 15 * ms

    virtually(main())


# Faults in the stream


def test_dropped_samples_are_never_read_and_counted() -> None:
    async def main() -> None:
        device = fake(drop=0.3)
        began = await opened(device)
        samples = await read_all(device, began + 10 * second)
        numbers = [sample.sequence for sample in samples]
        assert numbers == sorted(set(numbers))
        missing = numbers[-1] + 1 - len(numbers)
        assert 0.2 < missing / numbers[-1] < 0.4
        assert device.counters["samples_lost"] == pytest.approx(missing, abs=3)
        assert all(sample.world_time == began + sample.sequence * PERIOD for sample in samples)

    virtually(main())


def test_where_every_sample_is_dropped_none_comes_and_nothing_hangs() -> None:
    async def main() -> None:
        device = fake(drop=1.0)
        await opened(device, Scripted([0] * 100_000, np.full((100_000, 4), 0.5)))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1.0):
                await device.read(-1)
        assert device.next_event(now()) > now(), "when to look again"

    virtually(main())


def test_doubled_samples_are_read_once_and_counted() -> None:
    async def main() -> None:
        device = fake(duplicate=0.3)
        began = await opened(device)
        numbers = [sample.sequence for sample in await read_all(device, began + 10 * second)]
        assert numbers == list(range(numbers[-1] + 1))
        assert 0.2 < device.counters["samples_doubled"] / len(numbers) < 0.4

    virtually(main())


def test_corrupted_samples_do_not_fit_the_spec_and_the_others_are_true() -> None:
    async def main() -> None:
        device = fake(corrupt=0.3)
        began = await opened(device)
        samples = await read_all(device, began + 10 * second)
        true = [sample for sample in samples if age(sample) == sample.sequence * PERIOD]
        assert 0.6 < len(true) / len(samples) < 0.8
        strange = [age(sample) for sample in samples if sample not in true]
        assert any(math.isnan(value) for value in strange)
        assert any(value > 1e20 for value in strange)

    virtually(main())


def test_a_late_sample_is_overtaken_and_then_no_longer_the_newest() -> None:
    async def main() -> None:
        device = fake(late=0.3, lateness=35 * ms)
        began = await opened(device)
        samples = await read_all(device, began + 10 * second)
        numbers = [sample.sequence for sample in samples]
        assert numbers == sorted(set(numbers))
        arrivals = [sample.arrival_time - sample.world_time for sample in samples]
        assert set(arrivals) == {DELAY, DELAY + 35 * ms}
        # all that were late and overtaken are counted; only the late ones with none before them are read
        expected = numbers[-1] + 1 - len(numbers)
        assert device.counters["samples_overtaken"] == pytest.approx(expected, abs=4)
        assert device.counters["samples_overtaken"] > 100

    virtually(main())


def test_counters_go_on_counting_from_episode_to_episode() -> None:
    async def main() -> list[int]:
        device, counts = fake(duplicate=0.5), []
        for episode in range(3):
            await opened(device, rng(episode))
            await asyncio.sleep(1)
            counts.append(device.counters["samples_doubled"])
        return counts

    first, second_, third = virtually(main())
    assert first > 30
    assert 1.5 < second_ / first < 2.7
    assert 2.2 < third / first < 4.0


# Troubles


Call = Callable[[FakeDevice], Awaitable[object]]
CALLS: dict[str, Call] = {"read": lambda device: device.read(-1), "act": lambda device: device.act({"power": 0.0})}


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
@pytest.mark.parametrize("rate", [0.0, RATE])
def test_a_device_raises_once_at_each_time_that_was_given(call: Call, rate: float) -> None:
    async def main() -> list[bool]:
        device, failed = fake(rate=rate, raise_at=(25 * ms, 45 * ms)), []
        await opened(device)
        for _ in range(7):
            await asyncio.sleep(0.01)
            try:
                await call(device)
                failed.append(False)
            except DisconnectedError:
                raise
            except DeviceError:
                failed.append(True)
        return failed

    # at 10, 20, ... 70 ms: the first call after 25 ms, and the first after 45 ms
    assert virtually(main()) == [False, False, True, False, True, False, False]


@pytest.mark.parametrize("faults", [{"raise_at": (25 * ms,)}, {"disconnect": ((25 * ms, 35 * ms),)}])
def test_a_trouble_begins_at_its_very_nanosecond(faults: dict[str, object]) -> None:
    async def main() -> None:
        device = fake(rate=0.0, **faults)
        began = await opened(device)
        await current().sleep_until(began + 25 * ms - 1)
        await device.read(-1)
        await current().sleep_until(began + 25 * ms)
        with pytest.raises(DeviceError):
            await device.read(-1)

    virtually(main())


def test_a_device_is_back_at_the_very_end_of_a_window() -> None:
    async def main() -> None:
        device = fake(rate=0.0, disconnect=((25 * ms, 35 * ms),))
        began = await opened(device)
        await current().sleep_until(began + 35 * ms - 1)
        with pytest.raises(DisconnectedError):
            await device.open()
        await current().sleep_until(began + 35 * ms)
        await device.open()
        await device.read(-1)

    virtually(main())


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
def test_a_device_hangs_once_and_can_be_cancelled(call: Call) -> None:
    async def main() -> list[bool]:
        device, hung = fake(hang_at=(15 * ms,)), []
        await opened(device)
        for _ in range(3):
            await asyncio.sleep(0.01)
            try:
                async with asyncio.timeout(0.001):
                    await call(device)
                hung.append(False)
            except TimeoutError:
                hung.append(True)
        return hung

    assert virtually(main()) == [False, True, False]


@pytest.mark.parametrize("call", CALLS.values(), ids=CALLS)
@pytest.mark.parametrize("rate", [0.0, RATE])
def test_a_device_that_was_unplugged_is_gone_until_it_is_opened_after_the_window(call: Call, rate: float) -> None:
    async def main() -> None:
        device = fake(rate=rate, disconnect=((30 * ms, 60 * ms),))
        await opened(device)
        await asyncio.sleep(0.02)
        await call(device)
        await asyncio.sleep(0.02)
        for attempt in (call(device), device.open(), device.make_safe()):
            with pytest.raises(DisconnectedError):
                await attempt
        await asyncio.sleep(0.03)
        with pytest.raises(DisconnectedError):
            await call(device)
        await device.open()
        await call(device)

    virtually(main())


def test_a_device_that_was_unplugged_for_ever_stays_away() -> None:
    async def main() -> None:
        device = fake(disconnect=((30 * ms,),))
        await opened(device)
        await asyncio.sleep(1000)
        with pytest.raises(DisconnectedError):
            await device.open()

    virtually(main())


def test_an_unplugged_device_cannot_begin_an_episode() -> None:
    async def main() -> None:
        device = fake(disconnect=((30 * ms, 60 * ms),))
        await opened(device)
        await asyncio.sleep(0.04)
        with pytest.raises(DisconnectedError):
            await device.begin_episode(rng())

    virtually(main())


def test_a_read_that_waits_when_the_device_is_unplugged_gets_no_sample() -> None:
    async def main() -> None:
        device = fake(disconnect=((15 * ms, 35 * ms),))
        await opened(device)
        await asyncio.sleep(0.014)
        # sample 1 has arrived at 13 ms, number 2 would at 23 ms
        with pytest.raises(DisconnectedError):
            await device.read(1)

    virtually(main())


def test_a_device_that_was_unplugged_while_nobody_looked_has_to_be_opened_again() -> None:
    async def main() -> None:
        device = fake(disconnect=((15 * ms, 35 * ms),))
        await opened(device)
        await device.read(-1)
        await asyncio.sleep(0.05)
        with pytest.raises(DisconnectedError):
            await device.read(-1)
        await device.open()
        await device.read(-1)

    virtually(main())


# Settings that make no sense


@pytest.mark.parametrize(
    "settings",
    [
        {"rate": -1.0},
        {"rate": math.nan},
        {"rate": math.inf},
        {"rate": 1.0, "delay": -1},
        {"rate": 1.0, "jitter": -1},
        {"jitter": 1},
    ],
)
def test_a_sampling_that_makes_no_sense_is_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SpecError, match="sampling"):
        Sampling(**settings)  # type: ignore[arg-type]  # the names are those of Sampling


@pytest.mark.parametrize(
    "settings",
    [
        {"drop": 1.1},
        {"duplicate": -0.1},
        {"corrupt": math.nan},
        {"late": 2.0},
        {"disconnect": ((),)},
        {"disconnect": ((1, 2, 3),)},
        {"late": 0.5, "lateness": -1},
    ],
)
def test_faults_that_make_no_sense_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SpecError, match="faults"):
        Faults(**settings)  # type: ignore[arg-type]  # the names are those of Faults


@pytest.mark.parametrize("name", ["drop", "duplicate", "corrupt", "late"])
def test_faults_in_a_stream_need_a_stream(name: str) -> None:
    with pytest.raises(SpecError, match=r"sampling\.rate"):
        fake(rate=0.0, delay=0, **{name: 0.1})
