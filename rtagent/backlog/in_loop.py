"""Learning on the event loop: in one piece, or in slices with a look at the world after each."""

from __future__ import annotations

import asyncio
import contextlib
import types
from collections.abc import Callable, Generator
from typing import Any

from rtagent.backlog.backlog import DEFERRED, IN_PLACE, UNDER_PRESSURE, Backlog
from rtagent.clock import ready_counter
from rtagent.learn import When, Where
from rtagent.saving import Saved
from rtagent.senses import Senses
from rtagent.urgency import Urgency

MOST_ROUNDS = 3
"""From a byte in a pipe to a sample: its handler, the reading that waited for it, and one more."""


@types.coroutine
def yield_once() -> Generator[None, None, None]:
    """Let the event loop do whatever is ready (`asyncio.sleep(0)` without its overhead)."""
    yield


@types.coroutine
def look(ready: Callable[[], int]) -> Generator[None, None, None]:
    """Let the event loop take in what has arrived, and then whatever waited for that.

    What arrives stands behind a task that is ready already, so it is gone round again while something is `ready`.
    """
    yield
    for _ in range(MOST_ROUNDS):
        if not ready():
            return
        yield


class Inline:
    """Learns all that waits, whenever the schedule comes to it."""

    def __init__(self, backlog: Backlog) -> None:
        self.backlog = backlog
        self.weights: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()
        self.called = False
        self._queue, self._clock, self._costs = backlog.queue, backlog.desk.clock, backlog.desk.costs
        self._learned, self._in_place = backlog.desk.learned, 0

    @property
    def length(self) -> int:
        """How many transitions wait or are being learned."""
        return len(self.backlog)

    @property
    def progress(self) -> tuple[int, int]:
        """How many transitions were learned, and how many pieces of the next one."""
        current = self.backlog.current
        return self._in_place + self.backlog.learned, current.pieces if current else 0

    def oldest_age(self, now: int) -> int:
        """Return for how long (ns) the oldest transition has waited."""
        current = self.backlog.current
        oldest = current.transition if current else self._queue[0] if self._queue else None
        return now - oldest.complete_at if oldest else 0

    async def learn(self) -> None:
        """Learn every transition that waits."""
        if self._costs:
            while self._queue:
                await self._learn_one()
        else:
            self._learn_at_once()

    async def relieve(self) -> None:
        """See to it that no more transitions wait than may."""
        backlog = self.backlog
        while backlog.overfull:
            if backlog.sheds:
                backlog.shed()
            else:
                await self._learn_one(UNDER_PRESSURE)

    async def drain(self, deadline: int | None) -> None:
        """Learn what is left, without what it is said to cost, until `deadline` (ns; None: all of it)."""
        backlog = self.backlog
        while len(backlog) and (deadline is None or self._clock.now() < deadline):
            update = backlog.begin(sliced=False)
            while not backlog.step(update):
                pass
            backlog.end(update, DEFERRED)
            await yield_once()
        backlog.count(IN_PLACE, self._in_place)
        backlog.leave(len(backlog))

    def next_event(self, now: int) -> int | None:
        """Return when learning will have got further by itself: never, on the loop."""
        return None

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""

    def settle(self, wait: bool) -> bool:
        """Say whether nothing is half learned, so that it can be saved; `wait`: see to it."""
        update = self.backlog.current
        if update is not None and update.begun and wait:
            while not self.backlog.step(update):
                pass
            self.backlog.end(update)
        return self.backlog.current is None or not self.backlog.current.begun

    def unsettle(self) -> None:
        """Do nothing: it went on."""

    def save(self) -> Saved:
        """Return the update whose cost has partly passed, if any, and what was counted."""
        backlog = self.backlog
        return {
            "current": None if backlog.current is None else backlog.current.save(),
            "failed": backlog.failed,
            "called": self.called,
            "in_place": self._in_place,
            "learned": backlog.learned,
        }

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        current, backlog = saved["current"], self.backlog
        backlog.current = None if current is None else backlog.again(current, sliced=bool(backlog.rules.slice))
        backlog.failed, backlog.learned = saved["failed"], saved["learned"]
        self.called, self._in_place = saved["called"], saved["in_place"]

    def _learn_at_once(self) -> None:
        """Learn all that waits, each in one piece and at no cost but its own: what is done in every cycle."""
        queue, update, learned = self._queue, self.backlog.update, self._learned
        while queue:
            transition = queue.popleft()
            try:
                delta = update(transition)
            except Exception as error:
                self.backlog.give_up(error)
                return
            self._in_place += 1
            learned(transition, delta)

    async def _learn_one(self, how: str = "") -> None:
        """Learn the oldest transition, in one piece."""
        update = self.backlog.begin(sliced=False)
        if update.cost:
            await self._clock.compute(update.cost)
        while not self.backlog.step(update):
            pass
        self.backlog.end(update, how)


class InLoop(Inline):
    """Learns only while nothing is urgent, or in slices until something new has arrived, or both.

    `once`: it leaves off after each slice, and has looked at the world then.
    """

    def __init__(self, backlog: Backlog, senses: Senses, urgency: Urgency, *, once: bool = False) -> None:
        super().__init__(backlog)
        self._senses, self._urgency, self._once = senses, urgency, once
        self._looks = once or bool(backlog.rules.slice) or urgency.by_prediction
        self._slice, self._calm = backlog.rules.slice, backlog.rules.when is When.CALM
        self._recorder, self._ready = backlog.desk.recorder, ready_counter()
        self._learned_for = backlog.desk.learned_for
        self._never: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def learn(self) -> None:
        """Learn until nothing waits, or the world calls."""
        await self.relieve()
        if len(self.backlog):
            self._senses.watch()
        while len(self.backlog):
            if self._calm and await self._is_urgent():
                await self._wait_while_urgent()
                break
            await (self._learn_slice() if self._slice else self._learn_one())
            if (self._looks and await self._something_is_new()) or self._once:
                break
        if self.backlog.current is not None:
            self.backlog.current.suspended = True

    async def _learn_one(self, how: str = "") -> None:
        began = self._clock.now()
        await super()._learn_one(how)
        if self._slice:
            ended = self._clock.now()
            self._recorder.learning_time += ended - began
            if self._learned_for is not None:
                self._learned_for(began, ended, Where.LOOP)

    async def _learn_slice(self) -> None:
        """Learn for the length of a slice, by what the last piece took; an algorithm says where its pieces end."""
        now, update = self._clock.now, self.backlog.begin(sliced=True)
        began = now()
        if update.cost:
            cost = min(update.cost, self._slice)
            await self._clock.compute(cost)
            update.cost -= cost
        over, spent = False, now() - began
        while not over and not update.cost:
            over, before, spent = self.backlog.step(update), spent, now() - began
            if 2 * spent - before > self._slice:
                break
        self._recorder.slices.record(spent)
        self._recorder.learning_time += spent
        if self._learned_for is not None:
            self._learned_for(began, began + spent, Where.LOOP)
        if over:
            self.backlog.end(update)

    async def _something_is_new(self) -> bool:
        await look(self._ready)
        self.called = self._senses.news()
        return self.called

    async def _wait_while_urgent(self) -> None:
        """Wait for news where no device paces the cycle: the same again would only fill the queue."""
        senses = self._senses
        if not (senses.paced or senses.synchronous or senses.news()):
            await senses.wait_for_news(self._never)

    async def _is_urgent(self) -> bool:
        await look(self._ready)
        return await self._urgency()
