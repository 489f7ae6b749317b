"""What learning on the loop and on a thread does between two pieces of its work."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Generator
from types import SimpleNamespace

import pytest

from rtagent.backlog.backlog import Update
from rtagent.backlog.in_loop import MOST_ROUNDS, look
from rtagent.backlog.processors import LearnerThread
from rtagent.clock import ready_counter, real_loop
from rtagent.experience import Transition
from rtagent.learning.linear import NOTHING
from rtagent.schedule import Schedule
from rtagent.senses import Senses
from rtagent.units import ms

STEP = Transition(NOTHING, None, 1.0, 0.0, NOTHING, None, 0, False, False)


def on_real_loop(coroutine):
    loop = real_loop()
    try:
        return loop.run_until_complete(coroutine)
    finally:
        loop.close()


def test_after_a_look_who_waited_for_a_byte_in_a_pipe_has_it():
    async def looks() -> bool:
        loop, (end, other_end) = asyncio.get_running_loop(), os.pipe()
        arrived = loop.create_future()
        loop.add_reader(end, lambda: arrived.set_result(os.read(end, 1)))

        async def read() -> bytes:
            return await arrived

        reading = asyncio.ensure_future(read())
        await look(ready_counter())
        assert not reading.done()
        os.write(other_end, b"!")
        await look(ready_counter())
        loop.remove_reader(end)
        os.close(end)
        os.close(other_end)
        return reading.done()

    assert on_real_loop(looks())


def test_a_look_goes_round_once_where_nothing_has_arrived():
    async def rounds() -> int:
        count = 0

        def counts() -> int:
            nonlocal count
            count += 1
            return 0

        await look(counts)
        return count

    assert on_real_loop(rounds()) == 1


def test_a_look_ends_though_something_is_always_ready():
    async def rounds() -> int:
        loop, count = asyncio.get_running_loop(), 0

        def again() -> None:
            nonlocal count
            count += 1
            loop.call_soon(again)

        again()
        await look(ready_counter())
        return count

    assert on_real_loop(rounds()) <= MOST_ROUNDS + 2


class Pieces:
    """Says before each piece whether it leaves the action values alone; notes whether it had the weights."""

    def __init__(self, thread: LearnerThread, apart: bool) -> None:
        self._thread, self._apart = thread, apart
        self.held: list[bool] = []

    def updating(self, transition: object) -> Generator[bool | None, None, float]:
        for _ in range(3):
            self._note()
            yield self._apart
        self._note()
        return 0.0

    def _note(self) -> None:
        lock = self._thread.weights._lock
        held = not lock.acquire(blocking=False)
        if not held:
            lock.release()
        self.held.append(held)


@pytest.mark.parametrize("apart", [False, True])
def test_a_thread_holds_the_weights_for_all_pieces_but_those_apart(apart):
    thread = LearnerThread()
    learner = Pieces(thread, apart)
    update = Update(learner, STEP, 0, sliced=True)
    while not thread._step(update):
        pass
    assert learner.held == [True] + [not apart] * 3


def test_an_action_is_chosen_in_the_middle_of_a_piece_apart():
    thread = LearnerThread()
    chosen, begun = threading.Event(), threading.Event()

    class Learner:
        def updating(self, transition: object) -> Generator[bool | None, None, float]:
            yield True
            begun.set()
            assert chosen.wait(5)
            return 0.0

    update = Update(Learner(), STEP, 0, sliced=True)

    def learn() -> None:
        while not thread._step(update):
            pass

    learning = threading.Thread(target=learn)
    learning.start()
    assert begun.wait(5)
    with thread.weights:
        chosen.set()
    learning.join(5)
    assert not learning.is_alive()


def test_a_period_paces_the_cycle_also_where_a_device_is_read_as_of_now():
    device = SimpleNamespace(
        device=SimpleNamespace(spec=SimpleNamespace(rate=0.0, synchronous=False)),
        stimulating=False,
        supervision=SimpleNamespace(stale_after=0),
    )
    clock, recorder = SimpleNamespace(now=lambda: 0), SimpleNamespace(sample_age=SimpleNamespace(record=None))
    for period in (0, 5 * ms):
        schedule = Schedule.preset("deferred", period=period)
        assert Senses([device], schedule, clock, recorder).paced == bool(period)
