"""The real clock: fine timers, files and threads on the same loop, and computing that blocks."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import inspect
import os
import selectors
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import clock
from rtagent.clock import current, real_loop
from rtagent.clock.real import RealClock
from rtagent.units import ms, us

linux = pytest.mark.skipif(sys.platform != "linux", reason="the fine timers are those of Linux")


def now() -> int:
    return RealClock.now()


@pytest.fixture
def selector() -> Iterator[selectors.BaseSelector]:
    from rtagent.clock.real import TimerfdSelector

    made = TimerfdSelector()
    yield made
    made.close()


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    read, write = os.pipe()
    yield read, write
    os.close(read)
    os.close(write)


async def usual_nap(duration: float, tries: int) -> float:
    """Return the median of the times (ns) that sleeps of `duration` seconds took."""
    taken = []
    for _ in range(tries):
        began = now()
        await asyncio.sleep(duration)
        taken.append(now() - began)
    return median(taken)


@linux
def test_short_sleeps_are_much_shorter_than_on_a_loop_of_asyncio() -> None:
    fine = clock.run(usual_nap(1e-4, 50), "real")
    coarse = asyncio.run(usual_nap(1e-4, 50))
    assert fine < 0.7 * coarse


def test_sleeps_are_as_long_as_they_should_be_in_relation_to_each_other() -> None:
    short, long = clock.run(usual_nap(0.002, 10), "real"), clock.run(usual_nap(0.02, 3), "real")
    assert 5 < long / short < 15


@given(st.integers(0, 300 * us))
@settings(max_examples=30)
def test_a_sleep_never_ends_before_its_time(duration: int) -> None:
    async def main() -> int:
        when = now() + duration
        await current().sleep_until(when)
        return now() - when

    assert clock.run(main(), "real") >= 0


def test_sleeping_until_a_time_that_has_passed_takes_no_time() -> None:
    async def main() -> tuple[int, int]:
        began = now()
        await current().sleep_until(began - 10**9)
        past = now() - began
        await current().sleep_until(now() + 50 * ms)
        return past, now() - began - past

    past, future = clock.run(main(), "real")
    assert past < future / 5


def test_computing_takes_as_long_as_it_costs() -> None:
    async def fastest(cost: int) -> int:
        taken = []
        for _ in range(5):
            began = now()
            await current().compute(cost)
            taken.append(now() - began)
        return min(taken)

    async def main() -> float:
        return await fastest(10 * ms) / await fastest(2 * ms)

    assert 4 < clock.run(main(), "real") < 6


def test_computing_blocks_the_loop() -> None:
    async def main() -> int:
        ticks = 0

        async def tick() -> None:
            nonlocal ticks
            while True:
                ticks += 1
                await asyncio.sleep(0.0005)

        ticker = asyncio.create_task(tick())
        await asyncio.sleep(0.001)
        before = ticks
        await current().compute(20 * ms)
        during = ticks - before
        ticker.cancel()
        return during

    assert clock.run(main(), "real") == 0


def test_a_charge_costs_nothing_in_real_time() -> None:
    async def main() -> tuple[int, int]:
        began = now()
        await current().charge(10_000 * ms)
        charged = now() - began
        await current().compute(20 * ms)
        return charged, now() - began - charged

    charged, computed = clock.run(main(), "real")
    assert charged < computed


def test_a_machine_that_is_awake_is_not_taken_for_suspended() -> None:
    async def main() -> tuple[int, int]:
        began, before = now(), current().suspended()
        await asyncio.sleep(0.02)
        return abs(current().suspended() - before), now() - began

    slept, taken = clock.run(main(), "real")
    assert slept < taken / 5


def test_the_clock_is_real_on_any_other_loop() -> None:
    async def main() -> bool:
        return current().virtual

    assert not asyncio.run(main())
    assert not clock.run(main(), "real")


@linux
def test_sockets_wake_a_sleeping_loop() -> None:
    async def main() -> bytes:
        ours, theirs = socket.socketpair()
        reader, writer = await asyncio.open_connection(sock=ours)
        asyncio.get_running_loop().call_later(0.005, theirs.sendall, b"ping")
        async with asyncio.timeout(5):
            got = await reader.readexactly(4)
        writer.close()
        theirs.close()
        return got

    assert clock.run(main(), "real") == b"ping"


def test_a_thread_wakes_a_loop_that_waits_for_nothing_else() -> None:
    async def main() -> str:
        loop, woken = asyncio.get_running_loop(), asyncio.Event()
        await asyncio.sleep(0.002)
        thread = threading.Timer(0.01, loop.call_soon_threadsafe, (woken.set,))
        thread.start()
        await woken.wait()
        thread.join()
        return "woken"

    assert clock.run(main(), "real") == "woken"


def test_a_subprocess_can_be_awaited() -> None:
    async def main() -> int:
        process = await asyncio.create_subprocess_exec(sys.executable, "-S", "-c", "raise SystemExit(7)")
        return await process.wait()

    assert clock.run(main(), "real") == 7


@linux
def test_the_shortest_timeout_is_not_taken_for_none(
    selector: selectors.BaseSelector, pipe: tuple[int, int]
) -> None:
    read, write = pipe
    selector.register(read, selectors.EVENT_READ)
    rescue = threading.Timer(2.0, os.write, (write, b"x"))
    rescue.start()
    ready = [selector.select(timeout) for timeout in (5e-10, 1e-9, 1e-12)]
    rescue.cancel()
    rescue.join()
    assert ready == [[], [], []]


@linux
@pytest.mark.parametrize("looks", [0, 1])
def test_a_timer_that_has_rung_is_not_reported_and_does_not_ring_again(
    selector: selectors.BaseSelector, pipe: tuple[int, int], looks: int
) -> None:
    read, write = pipe
    selector.register(read, selectors.EVENT_READ)
    assert selector.select(0.001) == []
    assert [selector.select(0) for _ in range(looks)] == [[]] * looks
    threading.Timer(0.02, os.write, (write, b"x")).start()
    # without a timeout only the pipe may end the wait
    assert [key.fd for key, _ in selector.select(None)] == [read]


@linux
def test_a_timer_that_is_no_longer_waited_for_does_not_ring(
    selector: selectors.BaseSelector, pipe: tuple[int, int]
) -> None:
    read, write = pipe
    selector.register(read, selectors.EVENT_READ)
    os.write(write, b"x")
    assert selector.select(0.02)
    os.read(read, 1)
    threading.Timer(0.06, os.write, (write, b"x")).start()
    assert [key.fd for key, _ in selector.select(None)] == [read]


@linux
def test_the_kernel_is_asked_not_to_delay_the_timers_of_a_real_run() -> None:
    get_timer_slack = 30
    clock.run(asyncio.sleep(0), "real")
    assert ctypes.CDLL(None).prctl(get_timer_slack, 0, 0, 0, 0) == 1


@linux
def test_a_later_timeout_replaces_an_earlier_one(selector: selectors.BaseSelector) -> None:
    def wait(timeout: float) -> int:
        began = now()
        selector.select(timeout)
        return now() - began

    assert min(wait(0.02) for _ in range(3)) > 5 * min(wait(0.001) for _ in range(10))


@linux
def test_what_is_ready_is_reported_at_the_second_look_whatever_the_timeout(
    selector: selectors.BaseSelector, pipe: tuple[int, int]
) -> None:
    read, write = pipe
    selector.register(read, selectors.EVENT_READ)
    os.write(write, b"x")
    for timeout in (None, 0, 10.0, -1.0, 0):
        # a look without waiting may be left out once after something was found, and not again
        found = selector.select(timeout) or selector.select(timeout)
        assert [key.fd for key, _ in found] == [read]


@linux
def test_a_run_leaves_no_open_files_behind() -> None:
    def open_files() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    clock.run(asyncio.sleep(0), "real")
    gc.collect()  # what other tests have left must not be closed meanwhile
    before = open_files()
    for _ in range(5):
        clock.run(asyncio.sleep(0.0001), "real")
        real_loop().close()
    assert open_files() == before


def test_a_real_run_inside_a_running_loop_is_refused() -> None:
    async def outer() -> None:
        coroutine = asyncio.sleep(0)
        with pytest.raises(RuntimeError):
            clock.run(coroutine, "real")
        assert inspect.getcoroutinestate(coroutine) == inspect.CORO_CLOSED

    asyncio.run(outer())


def test_what_is_left_of_a_run_is_cancelled() -> None:
    notes = []

    async def background() -> None:
        try:
            await asyncio.sleep(1000)
        finally:
            notes.append("cancelled")

    async def main() -> None:
        tasks.append(asyncio.create_task(background()))
        await asyncio.sleep(0.001)

    tasks: list[asyncio.Task[None]] = []
    clock.run(main(), "real")
    assert notes == ["cancelled"]
