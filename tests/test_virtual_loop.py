"""The virtual clock: asyncio as it is known, in time that jumps."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import inspect
import logging
import math
import os
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from typing import Any

import pytest
from helpers import virtually
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import clock
from rtagent.clock import VirtualClock, VirtualLoop, current
from rtagent.errors import ClockError, RunStuckError
from rtagent.units import ms, second, us

DELAYS = st.integers(0, 6)


def now() -> int:
    return current().now()


async def elapsed(work: Awaitable[object]) -> int:
    """Return how long (ns) some work takes."""
    began = now()
    await work
    return now() - began


# Timers


@given(st.lists(st.tuples(DELAYS, st.booleans()), max_size=20))
@settings(max_examples=100)
def test_timers_fire_in_the_order_of_their_times_then_of_their_setting(timers: list[tuple[int, bool]]) -> None:
    fired: list[tuple[int, int]] = []

    async def main() -> int:
        began, loop = now(), asyncio.get_running_loop()
        for number, (delay, cancelled) in enumerate(timers):
            handle = loop.call_later(delay * 1e-3, lambda number=number: fired.append((now() - began, number)))
            if cancelled:
                handle.cancel()
        await asyncio.sleep(1.0)
        return now() - began

    assert virtually(main()) == second
    kept = [(delay * ms, number) for number, (delay, cancelled) in enumerate(timers) if not cancelled]
    assert fired == sorted(kept)


@given(st.lists(st.lists(DELAYS, min_size=1, max_size=6), max_size=8))
@settings(max_examples=60)
def test_tasks_that_sleep_wake_at_their_times_in_the_order_of_falling_asleep(plans: list[list[int]]) -> None:
    woken: list[tuple[int, int]] = []

    async def sleeper(number: int, delays: list[int], began: int) -> None:
        for delay in delays:
            await asyncio.sleep(delay * 1e-3)
            woken.append((now() - began, number))

    async def main() -> None:
        began = now()
        await asyncio.gather(*(sleeper(number, plan, began) for number, plan in enumerate(plans)))

    virtually(main())
    expected = [(sum(plan[: n + 1]) * ms, number) for number, plan in enumerate(plans) for n in range(len(plan))]
    assert sorted(woken) == sorted(expected)
    assert [time for time, _ in woken] == sorted(time for time, _ in woken)


@given(st.integers(0, 2 * 10**15), st.integers(0, 10**12), st.integers(0, 10**12))
@settings(max_examples=100)
def test_a_time_that_was_slept_until_is_reached_to_the_nanosecond(start: int, first: int, second_: int) -> None:
    async def main() -> list[int]:
        times = [now()]
        for delay in (first, second_):
            await current().sleep_until(now() + delay)
            times.append(now())
        return times

    assert virtually(main(), start) == [start, start + first, start + first + second_]


@given(st.integers(0, 10**15), st.integers(1, 10**10))
@settings(max_examples=100)
def test_a_timeout_comes_to_the_nanosecond(start: int, limit: int) -> None:
    async def main() -> int:
        began = now()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(limit / 1e9):
                await asyncio.sleep(1000)
        return now() - began

    assert virtually(main(), start) == limit


def test_a_timer_set_by_a_timer_for_the_same_time_fires_then() -> None:
    async def main() -> list[int]:
        began, loop, fired = now(), asyncio.get_running_loop(), []

        def first() -> None:
            fired.append(now() - began)
            loop.call_later(0, lambda: fired.append(now() - began))

        loop.call_later(0.001, first)
        await asyncio.sleep(0.002)
        return fired

    assert virtually(main()) == [ms, ms]


def test_a_timer_that_is_due_fires_although_another_task_never_rests() -> None:
    async def main() -> bool:
        fired = asyncio.Event()
        asyncio.get_running_loop().call_later(0, fired.set)
        for _ in range(100):
            await asyncio.sleep(0)
        return fired.is_set()

    assert clock.run(main(), "real")
    assert virtually(main())


def test_time_does_not_pass_while_something_is_ready() -> None:
    async def main() -> tuple[int, bool]:
        rang = asyncio.Event()
        asyncio.get_running_loop().call_later(1e-9, rang.set)
        began = now()
        for _ in range(1000):
            await asyncio.sleep(0)
        return now() - began, rang.is_set()

    assert virtually(main()) == (0, False)


def test_time_begins_where_it_is_told_and_far_from_the_machine_s_own() -> None:
    async def main() -> int:
        return now()

    assert virtually(main(), 12345) == 12345
    assert virtually(main()) == virtually(main())
    assert abs(virtually(main()) - clock.run(main(), "real")) > second


def test_the_time_of_the_loop_is_that_of_the_clock_in_seconds() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        for _ in range(3):
            assert loop.time() * 1e9 == pytest.approx(now(), abs=0.2)
            await asyncio.sleep(0.123456789)

    virtually(main())


# What asyncio is known for


def test_a_gather_lasts_as_long_as_its_longest() -> None:
    async def value(delay: float) -> float:
        await asyncio.sleep(delay)
        return delay

    async def main() -> tuple[list[float], int]:
        began = now()
        return await asyncio.gather(value(0.3), value(0.1), value(0.2)), now() - began

    assert virtually(main()) == ([0.3, 0.1, 0.2], 300 * ms)


def test_an_event_wakes_all_who_wait_when_it_is_set() -> None:
    async def main() -> list[int]:
        event = asyncio.Event()
        asyncio.get_running_loop().call_later(0.05, event.set)
        return list(await asyncio.gather(*(elapsed(event.wait()) for _ in range(3))))

    assert virtually(main()) == [50 * ms] * 3


def test_a_queue_hands_over_in_order_and_blocks_when_full() -> None:
    async def main() -> tuple[list[tuple[int, int]], int]:
        queue: asyncio.Queue[int] = asyncio.Queue(maxsize=2)
        began, got = now(), []

        async def produce() -> int:
            for number in range(5):
                await queue.put(number)
            return now() - began

        producer = asyncio.create_task(produce())
        for _ in range(5):
            await asyncio.sleep(0.01)
            got.append((await queue.get(), now() - began))
        return got, await producer

    got, produced = virtually(main())
    assert got == [(number, (number + 1) * 10 * ms) for number in range(5)]
    # two fit at once, one more each time that one is taken: the fifth after the third was taken
    assert produced == 30 * ms


def test_a_timeout_that_is_not_reached_costs_nothing() -> None:
    async def main() -> int:
        async with asyncio.timeout(10):
            return await elapsed(asyncio.sleep(0.2))

    assert virtually(main()) == 200 * ms


def test_a_timeout_without_end_never_comes() -> None:
    async def main() -> int:
        async with asyncio.timeout(math.inf):
            return await elapsed(asyncio.wait_for(asyncio.sleep(0.01), math.inf))

    assert virtually(main()) == 10 * ms


def test_a_sleep_without_end_can_be_cancelled_and_is_nothing_to_wait_for() -> None:
    async def main() -> int:
        task = asyncio.create_task(asyncio.sleep(math.inf))
        taken = await elapsed(asyncio.wait([task], timeout=0.01))
        task.cancel()
        return taken

    assert virtually(main()) == 10 * ms
    with pytest.raises(RunStuckError):
        virtually(asyncio.sleep(math.inf))


def test_wait_returns_at_the_first_result_or_at_its_timeout() -> None:
    async def main() -> tuple[int, int, int]:
        tasks = {asyncio.create_task(asyncio.sleep(delay)) for delay in (0.1, 0.4, 0.9)}
        began = now()
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        first = now() - began
        done, pending = await asyncio.wait(tasks, timeout=0.5)
        return first, now() - began, len(pending) * 10 + len(done)

    assert virtually(main()) == (100 * ms, 600 * ms, 12)


def test_a_cancelled_task_cleans_up_and_ends() -> None:
    async def main() -> list[str]:
        notes: list[str] = []

        async def work() -> None:
            try:
                await asyncio.sleep(1000)
            finally:
                await asyncio.sleep(0.1)
                notes.append("cleaned up")

        task = asyncio.create_task(work())
        await asyncio.sleep(0.1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return notes

    assert virtually(main()) == ["cleaned up"]


def test_a_task_group_cancels_the_others_when_one_fails() -> None:
    async def fail() -> None:
        await asyncio.sleep(0.1)
        raise ValueError("broken")

    async def both() -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(fail())
            group.create_task(asyncio.sleep(1000))

    async def main() -> int:
        began = now()
        with pytest.raises(ExceptionGroup):
            await both()
        return now() - began

    assert virtually(main()) == 100 * ms


def test_locks_conditions_and_shields_work() -> None:
    async def main() -> list[int]:
        lock, began, entered = asyncio.Lock(), now(), []

        async def work() -> None:
            async with lock:
                entered.append(now() - began)
                await asyncio.sleep(0.01)

        inner = asyncio.create_task(asyncio.sleep(0.2))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(asyncio.shield(inner), 0.1)
        assert not inner.cancelled()
        began = now()
        await asyncio.gather(work(), work(), work())
        return entered

    assert virtually(main()) == [0, 10 * ms, 20 * ms]


def test_a_context_is_kept_by_tasks_and_callbacks() -> None:
    variable: contextvars.ContextVar[int] = contextvars.ContextVar("variable", default=0)

    async def main() -> list[int]:
        seen = []
        variable.set(1)
        asyncio.get_running_loop().call_later(0.1, lambda: seen.append(variable.get()))
        task = asyncio.create_task(asyncio.sleep(0.2), context=contextvars.copy_context())
        variable.set(2)
        await task
        return [*seen, variable.get()]

    assert virtually(main()) == [1, 2]


def test_work_for_a_thread_is_done_and_its_error_raised() -> None:
    def fail() -> None:
        raise ValueError("broken")

    async def main() -> int:
        with pytest.raises(ValueError, match="broken"):
            await asyncio.to_thread(fail)
        return await asyncio.to_thread(pow, 2, 10)

    assert virtually(main()) == 1024


def test_an_abandoned_generator_is_closed_in_the_loop() -> None:
    async def main(notes: list[str]) -> None:
        async def numbers() -> AsyncIterator[int]:
            try:
                for number in range(10):
                    yield number
            finally:
                await asyncio.sleep(0)
                notes.append("closed")

        async for number in numbers():
            if number == 2:
                break
        await asyncio.sleep(0.01)

    for name in ("real", "virtual"):
        notes: list[str] = []
        clock.run(main(notes), name)  # type: ignore[arg-type]  # both names are those of clocks
        assert notes == ["closed"]


def test_a_generator_that_is_left_at_the_end_of_a_run_is_closed() -> None:
    kept: list[AsyncIterator[int]] = []
    notes: list[str] = []

    async def main() -> None:
        async def numbers() -> AsyncIterator[int]:
            try:
                yield 1
            finally:
                await asyncio.sleep(0.001)
                notes.append("closed")

        kept.append(numbers())
        await anext(kept[0])

    virtually(main())
    assert notes == ["closed"]


def test_a_run_leaves_no_trace_in_the_interpreter() -> None:
    async def main() -> None:
        await asyncio.sleep(1)

    before = sys.get_asyncgen_hooks()
    virtually(main())
    assert sys.get_asyncgen_hooks() == before
    with pytest.raises(RuntimeError):
        asyncio.get_running_loop()


def test_an_error_in_a_callback_is_handed_to_the_handler_and_the_loop_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    contexts: list[dict[str, Any]] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.call_soon(lambda: 1 / 0)
        await asyncio.sleep(0.1)
        loop.set_exception_handler(lambda _, context: contexts.append(context))
        assert loop.get_exception_handler() is not None
        loop.call_later(0.1, lambda: 1 / 0)
        await asyncio.sleep(0.2)

    with caplog.at_level(logging.ERROR):
        virtually(main())
    assert [type(context["exception"]) for context in contexts] == [ZeroDivisionError]
    assert len(caplog.records) == 1


def test_a_task_factory_makes_the_tasks() -> None:
    made: list[asyncio.Task[Any]] = []

    def factory(loop: asyncio.AbstractEventLoop, coro: Any, **settings: Any) -> asyncio.Task[Any]:
        made.append(asyncio.Task(coro, loop=loop, **settings))
        return made[-1]

    async def main() -> None:
        asyncio.get_running_loop().set_task_factory(factory)
        await asyncio.create_task(asyncio.sleep(0), name="named")

    virtually(main())
    assert "named" in [task.get_name() for task in made]


# What it refuses


def test_every_function_of_a_loop_is_there_or_refused_with_a_sentence() -> None:
    missing = [
        name
        for name in dir(asyncio.AbstractEventLoop)
        if not name.startswith("_") and getattr(VirtualLoop, name) is getattr(asyncio.AbstractEventLoop, name)
    ]
    assert missing == []


async def _open_connection() -> None:
    await asyncio.open_connection("127.0.0.1", 1)


async def _serve() -> None:
    await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)


async def _subprocess() -> None:
    await asyncio.create_subprocess_exec("true")


async def _shell() -> None:
    await asyncio.create_subprocess_shell("true")


async def _reader() -> None:
    read, write = os.pipe()
    try:
        asyncio.get_running_loop().add_reader(read, print)
    finally:
        os.close(read)
        os.close(write)


async def _socket() -> None:
    with socket.socket() as unconnected:
        await asyncio.get_running_loop().sock_recv(unconnected, 1)


async def _name() -> None:
    await asyncio.get_running_loop().getaddrinfo("localhost", 80)


async def _signal() -> None:
    asyncio.get_running_loop().add_signal_handler(2, print)


@pytest.mark.parametrize(
    "attempt", [_open_connection, _serve, _subprocess, _shell, _reader, _socket, _name, _signal]
)
def test_what_needs_the_real_world_is_refused_with_a_sentence(
    attempt: Callable[[], Coroutine[Any, Any, None]],
) -> None:
    with pytest.raises(ClockError, match=r"needs the real world.*--clock real.*\.$"):
        virtually(attempt())


def test_a_run_in_which_nothing_will_happen_again_is_ended_with_a_sentence() -> None:
    cleaned_up = []

    async def main() -> None:
        try:
            await asyncio.sleep(1)
            await asyncio.get_running_loop().create_future()
        finally:
            cleaned_up.append(True)

    with pytest.raises(RunStuckError, match="nothing is left to happen"):
        virtually(main())
    assert cleaned_up == [True]


def test_two_tasks_that_wait_for_each_other_are_found_out() -> None:
    async def main() -> None:
        first, second_ = asyncio.Lock(), asyncio.Lock()

        async def take(one: asyncio.Lock, other: asyncio.Lock) -> None:
            async with one:
                await asyncio.sleep(0.1)
                async with other:
                    pass

        await asyncio.gather(take(first, second_), take(second_, first))

    with pytest.raises(RunStuckError):
        virtually(main())


def test_a_cancelled_timer_does_not_keep_a_stuck_run_alive() -> None:
    async def main() -> None:
        asyncio.get_running_loop().call_later(1000, print).cancel()
        await asyncio.get_running_loop().create_future()

    with pytest.raises(RunStuckError):
        virtually(main())


def test_a_virtual_run_inside_a_running_loop_is_refused_and_the_outer_loop_goes_on() -> None:
    async def inner() -> None:
        await asyncio.sleep(1)

    async def outer() -> bool:
        coroutine = inner()
        with pytest.raises(RuntimeError):
            clock.run(coroutine, "virtual")
        assert inspect.getcoroutinestate(coroutine) == inspect.CORO_CLOSED
        await asyncio.sleep(0)
        return asyncio.get_running_loop().is_running()

    assert asyncio.run(outer())


def test_a_closed_loop_takes_no_more_work() -> None:
    loops: list[asyncio.AbstractEventLoop] = []

    async def main() -> None:
        loops.append(asyncio.get_running_loop())

    virtually(main())
    assert loops[0].is_closed()
    for attempt in (loops[0].call_soon, lambda callback: loops[0].call_later(1, callback)):
        with pytest.raises(RuntimeError, match="closed"):
            attempt(print)
    with pytest.raises(RuntimeError, match="closed"):
        loops[0].run_forever()


def test_a_loop_that_runs_cannot_be_run_again() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        with pytest.raises(RuntimeError):
            loop.run_forever()

    virtually(main())


# The end of a run


def test_what_main_raises_is_raised_and_the_rest_is_cancelled() -> None:
    notes = []

    async def background() -> None:
        try:
            await asyncio.sleep(1000)
        finally:
            await asyncio.sleep(0.5)
            notes.append("cancelled")

    async def main() -> None:
        tasks.append(asyncio.create_task(background()))
        await asyncio.sleep(0.1)
        raise ValueError("broken")

    tasks: list[asyncio.Task[None]] = []
    with pytest.raises(ValueError, match="broken"):
        virtually(main())
    assert notes == ["cancelled"]


def test_a_task_that_will_not_end_does_not_hang_a_run() -> None:
    async def stubborn() -> None:
        while True:
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(1000)

    async def main() -> str:
        asyncio.get_running_loop().set_exception_handler(lambda *_: None)
        tasks.append(asyncio.create_task(stubborn()))
        await asyncio.sleep(0.1)
        return "done"

    tasks: list[asyncio.Task[None]] = []
    assert virtually(main()) == "done"


def test_the_same_program_runs_the_same_way_every_time() -> None:
    async def worker(number: int, notes: list[tuple[int, int]]) -> None:
        for turn in range(20):
            await asyncio.sleep((number * 7 + turn * 3) % 5 * 1e-3)
            notes.append((number, now()))

    async def main() -> list[tuple[int, int]]:
        notes: list[tuple[int, int]] = []
        await asyncio.gather(*(worker(number, notes) for number in range(5)))
        return notes

    assert virtually(main()) == virtually(main())


# The processor


def test_computing_takes_virtual_time_while_events_fire_at_their_own() -> None:
    async def main() -> tuple[list[int], int]:
        began, loop, fired = now(), asyncio.get_running_loop(), []
        for delay in (3, 7, 12):
            loop.call_later(delay * 1e-3, lambda: fired.append(now() - began))
        await current().compute(10 * ms)
        return list(fired), now() - began

    assert virtually(main()) == ([3 * ms, 7 * ms], 10 * ms)


@given(st.lists(st.integers(0, 5 * us), min_size=1, max_size=6))
@settings(max_examples=50)
def test_computations_occupy_one_processor_one_after_the_other(costs: list[int]) -> None:
    async def main() -> list[int]:
        processor, began = current(), now()

        async def compute(cost: int) -> int:
            await processor.compute(cost)
            return now() - began

        return list(await asyncio.gather(*(compute(cost) for cost in costs)))

    assert virtually(main()) == [sum(costs[: place + 1]) for place in range(len(costs))]


def test_there_is_one_processor_however_often_the_clock_is_asked_for() -> None:
    async def main() -> int:
        return await elapsed(asyncio.gather(*(current().charge(10 * ms) for _ in range(3))))

    assert virtually(main()) == 30 * ms


def test_a_computation_alone_jumps_ahead_without_a_round_of_the_loop() -> None:
    async def main() -> int:
        began = now()
        computation = VirtualClock.compute(current(), 5 * ms)  # type: ignore[arg-type]  # it is a virtual clock here
        with pytest.raises(StopIteration):
            computation.send(None)
        return now() - began

    assert virtually(main()) == 5 * ms


def test_sleeping_until_a_time_that_has_passed_returns_at_once() -> None:
    async def main() -> int:
        return await elapsed(current().sleep_until(now() - second))

    assert virtually(main()) == 0


def test_a_cancelled_sleep_leaves_no_timer_behind() -> None:
    async def main() -> int | None:
        task = asyncio.create_task(current().sleep_until(now() + second))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        return loop.next_timer()

    assert virtually(main()) is None
