"""Learning elsewhere than on the event loop: transitions are handed over, and the loop goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

from rtagent.backlog.backlog import UNDER_PRESSURE, Backlog, Update
from rtagent.learn import Where
from rtagent.saving import Saved
from rtagent.senses import Senses
from rtagent.units import second


class Processor(Protocol):
    """What learns: it takes transitions from the backlog, the oldest first, and says on the loop when one is over.

    `held`: it takes nothing, as it is to be saved. `taken` says how many it took; that and the queue are looked at
    together only within `gate`. Within `weights` nothing learns.
    """

    taken: int
    held: bool
    update: Update | None
    gate: AbstractContextManager[Any]
    weights: AbstractContextManager[Any]

    def start(self, backlog: Backlog, over: Callable[[Update, BaseException | None], None]) -> None:
        """Begin to work."""

    def wake(self) -> None:
        """Say that transitions wait, and are not to be held back."""

    def next_event(self, now: int) -> int | None:
        """Return when (ns) it will be done with what it does, where that is known."""

    def close(self) -> None:
        """End; what it was doing is left where it is."""

    def settle(self) -> int:
        """Take nothing more; return how many were taken of which nothing is done before all is."""

    def unsettle(self) -> None:
        """Go on, if it was held back."""

    def save(self) -> Saved | None:
        """Return what it is doing, if anything; nothing of it is done yet."""

    def restore(self, saved: Saved | None) -> None:
        """Go on with what was saved."""


class Elsewhere:
    """Learns on another processor."""

    def __init__(self, backlog: Backlog, senses: Senses, processor: Processor) -> None:
        self.backlog, self._senses, self._processor = backlog, senses, processor
        self.weights = processor.weights
        self.next_event = processor.next_event
        self.called = False
        self._queue, self._clock = backlog.queue, backlog.desk.clock
        self._over = 0
        self._pressed = False
        self._progress = asyncio.get_running_loop().create_future()
        processor.start(backlog, self._end)

    @property
    def length(self) -> int:
        """How many transitions wait or are being learned."""
        with self._processor.gate:
            return len(self._queue) + self._processor.taken - self._over

    @property
    def progress(self) -> tuple[int, int]:
        """How many transitions were learned, and how many pieces of the next one, as far as can be told."""
        update = self._processor.update
        return self.backlog.learned, update.pieces if update else 0

    def oldest_age(self, now: int) -> int:
        """Return for how long (ns) the oldest transition has waited."""
        with self._processor.gate:
            update = self._processor.update if self._processor.taken > self._over else None
            oldest = update.transition if update else self._queue[0] if self._queue else None
        return now - oldest.complete_at if oldest else 0

    async def learn(self) -> None:
        """Hand over what waits; where no device paces the cycle, wait until it is learned or something is new."""
        await self.relieve()
        if self._queue and not self._processor.held:
            self._processor.wake()
        if not self._senses.paced and self.length:
            self._processor.wake()
            self._senses.watch()
            while self.length and not self._senses.news():
                await self._senses.wait_for_news(self._progress)

    async def relieve(self) -> None:
        """See to it that no more transitions wait than may: drop the newest, or wait for the oldest."""
        backlog = self.backlog
        if not backlog.overfull:
            return
        if backlog.sheds:
            with self._processor.gate:
                while backlog.overfull:
                    backlog.shed()
            return
        self._processor.wake()
        self._pressed = True
        while backlog.overfull:
            await asyncio.wait({self._progress})
        self._pressed = False

    async def drain(self, deadline: int | None) -> None:
        """Learn what is left until `deadline` (ns; None: all of it); the rest is counted."""
        await self._learn_until(deadline)
        self._processor.close()
        await asyncio.sleep(0)  # so that what was over before is told
        self.backlog.leave(self.length)
        self._over = self._processor.taken

    def close(self) -> None:
        """End learning."""
        self._processor.close()

    def settle(self, wait: bool) -> bool:
        """Say whether nothing is half learned, so that it can be saved; until `unsettle` nothing more is begun."""
        return self._over == self._processor.taken - self._processor.settle()

    def unsettle(self) -> None:
        """Let learning go on."""
        self._processor.unsettle()

    def save(self) -> Saved:
        """Return what is being learned; the queue is the agent's."""
        backlog, doing = self.backlog, self._processor.save()
        return {"doing": doing, "failed": backlog.failed, "learned": backlog.learned, "called": self.called}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self.backlog.failed, self.backlog.learned = saved["failed"], saved["learned"]
        self.called = saved["called"]
        self._processor.restore(saved["doing"])

    async def _learn_until(self, deadline: int | None) -> None:
        self._processor.wake()
        while self.length and (deadline is None or self._clock.now() < deadline):
            left = None if deadline is None else (deadline - self._clock.now()) / second
            await asyncio.wait({self._progress}, timeout=left)

    def _end(self, update: Update, error: BaseException | None) -> None:
        """Note, on the loop, that an update is over."""
        self._over += 1
        self.backlog.desk.recorder.learning_time += update.spent
        if self.backlog.desk.learned_for is not None:
            self.backlog.desk.learned_for(update.began, update.began + update.spent, Where.THREAD)
        if error is None:
            self.backlog.end(update, UNDER_PRESSURE if self._pressed else "")
        else:
            self.backlog.give_up(error)
        progress, self._progress = self._progress, self._progress.get_loop().create_future()
        progress.set_result(None)
