"""The timer: it expires once in an episode, and has nothing new before and after."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from rtagent.clock import ClockName, current
from rtagent.errors import DisconnectedError, SpecError
from rtagent.testing import DeviceContract
from rtagent.units import ms, second
from rtagent_drivers.timer import Timer
from tests.helpers import virtually


class TestTimer(DeviceContract):
    samples_by_itself = False

    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return Timer()


class TestTimerInVirtualTime(TestTimer):
    clock: ClockName = "virtual"


async def wound(seed: int = 3, after: tuple[int, int] = (100 * ms, 200 * ms)) -> Timer:
    timer = Timer(after=after)
    await timer.open()
    await timer.begin_episode(np.random.default_rng(seed))
    return timer


def test_who_waits_is_told_at_the_moment_of_expiry() -> None:
    async def story() -> None:
        began = current().now()
        timer = await wound()
        due = timer.next_event(began)
        before, expired = await timer.read(-1), await timer.read(0)
        assert due is not None
        assert began + 100 * ms <= due <= began + 200 * ms
        assert (before.values, before.world_time) == ({"expired": False}, began)
        assert (expired.values, expired.world_time, current().now()) == ({"expired": True}, due, due)
        assert [stimulus.time for stimulus in timer.stimuli(began, due)] == [due]
        assert timer.next_event(due) is None

    virtually(story())


def test_it_expires_only_once_in_an_episode_and_never_before_one() -> None:
    async def story() -> None:
        timer = Timer()
        await timer.open()
        for newer_than in (0, 1):
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(10):
                    await timer.read(newer_than)
            await timer.begin_episode(np.random.default_rng(1))

    virtually(story())


def test_the_seed_decides_when() -> None:
    async def due(seed: int) -> int:
        began = current().now()
        return ((await wound(seed, (0 * ms + 1, second))).next_event(began) or 0) - began

    assert virtually(due(1)) == virtually(due(1)) != virtually(due(2))


def test_a_timer_that_was_closed_tells_who_waits() -> None:
    async def story() -> None:
        timer = await wound()
        waiting = asyncio.ensure_future(timer.read(0))
        await asyncio.sleep(0)
        await timer.close()
        with pytest.raises(DisconnectedError, match="open it first"):
            await waiting

    virtually(story())


@pytest.mark.parametrize("after", [(0, 5), (5, 4), (-1, 5)])
def test_a_range_that_is_none_is_refused(after: tuple[int, int]) -> None:
    with pytest.raises(SpecError, match="earliest, latest"):
        Timer(after=after)
