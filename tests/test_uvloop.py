"""The event loop of uvloop's with timers of our own: sleeps, order, cancelling, errors, nothing left behind."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import clock, us
from rtagent.clock import RealClock

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="its timers are those of Linux")

T = TypeVar("T")


def on_uvloop(main: Coroutine[Any, Any, T]) -> T:
    from rtagent.clock.uv import uvloop_loop

    return clock.run(main, "real", make_loop=uvloop_loop)


async def late(duration: int) -> int:
    when = RealClock.now() + duration
    await clock.current().sleep_until(when)
    return RealClock.now() - when


@given(st.integers(0, 3000 * us))
@settings(max_examples=40)
def test_a_sleep_never_ends_before_its_time(duration: int) -> None:
    assert on_uvloop(late(duration)) >= 0


def test_short_sleeps_are_shorter_than_those_of_uvloop_itself() -> None:
    import uvloop

    async def naps() -> float:
        return median([abs(await late(1400 * us)) for _ in range(40)])

    own = uvloop.new_event_loop()
    coarse = own.run_until_complete(naps())
    own.close()
    assert on_uvloop(naps()) < 0.7 * coarse


@given(st.lists(st.integers(-1, 5), min_size=1, max_size=30), st.data())
@settings(max_examples=30)
def test_timers_ring_in_order_of_time_then_of_asking_and_cancelled_ones_do_not(
    delays: list[int], data: st.DataObject
) -> None:
    cancelled = data.draw(st.sets(st.integers(0, len(delays) - 1)))

    async def main() -> list[int]:
        loop, rung = asyncio.get_running_loop(), list[int]()
        start = loop.time() + 0.001
        timers = [loop.call_at(start + delay * 2e-4, rung.append, n) for n, delay in enumerate(delays)]
        for number in cancelled:
            timers[number].cancel()
        await asyncio.sleep(0.004)
        return rung

    expected = sorted(set(range(len(delays))) - cancelled, key=lambda number: (delays[number], number))
    assert on_uvloop(main()) == expected


def test_many_cancelled_timers_are_forgotten() -> None:
    from rtagent.clock.uv import MANY_CANCELLED, FineUvloop

    async def main() -> tuple[int, list[str]]:
        loop, rung = asyncio.get_running_loop(), list[str]()
        assert isinstance(loop, FineUvloop)
        loop.call_later(0.01, rung.append, "kept")
        for _ in range(20 * MANY_CANCELLED):
            loop.call_later(1000, rung.append, "never").cancel()
        left = len(loop._timers)
        await asyncio.sleep(0.02)
        return left, rung

    left, rung = on_uvloop(main())
    assert left <= 2 * MANY_CANCELLED
    assert rung == ["kept"]


def test_a_timer_that_rings_again_and_again_does_not_shut_out_events() -> None:
    async def main() -> int:
        loop, rings = asyncio.get_running_loop(), 0
        read, write = os.pipe()
        heard = loop.create_future()

        def again() -> None:
            nonlocal rings
            rings += 1
            if not heard.done():
                loop.call_later(0, again)

        loop.add_reader(read, lambda: heard.done() or heard.set_result(os.read(read, 1)))
        again()
        thread = threading.Timer(0.01, os.write, (write, b"x"))
        thread.start()
        await asyncio.wait_for(heard, 5)
        thread.join()
        loop.remove_reader(read)
        os.close(read)
        os.close(write)
        return rings

    assert on_uvloop(main()) > 1


def test_a_callback_that_raises_is_told_and_stops_no_other_timer() -> None:
    async def main() -> tuple[list[str], list[str]]:
        loop, rung, told = asyncio.get_running_loop(), list[str](), list[str]()
        loop.set_exception_handler(lambda _, context: told.append(repr(context["exception"])))
        when = loop.time() + 0.001
        loop.call_at(when, lambda: 1 / 0)
        loop.call_at(when, rung.append, "next")
        await asyncio.sleep(0.005)
        return rung, told

    assert on_uvloop(main()) == (["next"], ["ZeroDivisionError('division by zero')"])


def test_a_timeout_of_asyncio_ends_a_wait() -> None:
    async def main() -> None:
        async with asyncio.timeout(0.002):
            await asyncio.sleep(10)

    with pytest.raises(TimeoutError):
        on_uvloop(main())


def test_a_keyboard_interrupt_in_a_timer_ends_the_run() -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    async def main() -> None:
        asyncio.get_running_loop().call_later(0.001, interrupt)
        await asyncio.sleep(10)

    with pytest.raises(KeyboardInterrupt):
        on_uvloop(main())


def test_a_subprocess_and_a_thread_wake_it() -> None:
    async def main() -> tuple[int, int]:
        process = await asyncio.create_subprocess_exec(sys.executable, "-S", "-c", "raise SystemExit(7)")
        return await process.wait(), await asyncio.to_thread(lambda: 8)

    assert on_uvloop(main()) == (7, 8)


def test_a_run_leaves_no_open_files_behind() -> None:
    def open_files() -> int:
        return len(list(Path("/proc/self/fd").iterdir()))

    on_uvloop(asyncio.sleep(0))
    before = open_files()
    for _ in range(5):
        on_uvloop(asyncio.sleep(0.0001))
    assert open_files() == before


def test_closing_twice_does_no_harm() -> None:
    from rtagent.clock.uv import uvloop_loop

    loop = uvloop_loop()
    close: Callable[[], None] = loop.close
    close()
    close()
    assert loop.is_closed()
