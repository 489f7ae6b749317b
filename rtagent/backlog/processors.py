"""The processors that learn beside the event loop: a thread, and the second one of the virtual clock."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rtagent.backlog.backlog import Backlog, Update
from rtagent.clock import occupy
from rtagent.saving import Saved

JOIN_TIMEOUT = 1.0
"""So long (s) is waited for a thread whose learner does not return."""

Over = Callable[[Update, BaseException | None], None]


class LearnerThread:
    """A thread that learns. Its kernels hold no GIL; between two of them whoever reads the weights comes first."""

    def __init__(self, on_thread: Callable[[], None] | None = None) -> None:
        self.taken, self._on_thread = 0, on_thread
        self.update: Update | None = None
        self.gate: AbstractContextManager[Any] = threading.Lock()
        self.weights: AbstractContextManager[Any] = _Turn(self.gate, threading.Lock())
        self._waiting = threading.Semaphore(0)
        self._closing = self.held = False
        self._thread = threading.Thread(target=self._work, name="rtagent-learner", daemon=True)

    def start(self, backlog: Backlog, over: Over) -> None:
        """Begin to work."""
        self._backlog, self._over, self._loop = backlog, over, asyncio.get_running_loop()
        self._thread.start()

    def wake(self) -> None:
        """Say that transitions wait, and are not to be held back."""
        self.held = False
        self._waiting.release()

    def next_event(self, now: int) -> int | None:
        """Return None: when it will be done is not known."""
        return None

    def settle(self) -> int:
        """Take nothing more; return 0, as any update may be half done."""
        with self.gate:
            self.held = True
        return 0

    def unsettle(self) -> None:
        """Go on, if it was held back."""
        if self.held:
            self.wake()

    def save(self) -> Saved | None:
        """Return None: it is saved when it does nothing."""
        return None

    def restore(self, saved: Saved | None) -> None:
        """Do nothing: it did nothing."""

    def close(self) -> None:
        """End after the piece of work that it is at."""
        self._closing = True
        self._waiting.release()
        if self._thread.is_alive():
            self._thread.join(JOIN_TIMEOUT)

    def _work(self) -> None:
        if self._on_thread is not None:
            self._on_thread()
        while not self._closing:
            self._waiting.acquire()
            while not self._closing and (update := self._take()) is not None:
                error = self._learn(update)
                if self._closing:
                    return
                self._loop.call_soon_threadsafe(self._over, update, error)
                if error is not None:
                    return

    def _take(self) -> Update | None:
        with self.gate:
            takes = bool(self._backlog.queue) and not self.held
            self.update = self._backlog.take(sliced=True) if takes else None
            self.taken += self.update is not None
        return self.update

    def _learn(self, update: Update) -> BaseException | None:
        began = update.began = self._backlog.desk.clock.now()
        occupy(update.cost)
        try:
            while not self._closing and not self._step(update):
                pass
        except BaseException as error:  # a thread that ended without a word would be waited for
            return error
        finally:
            update.spent = self._backlog.desk.clock.now() - began
        return None

    def _step(self, update: Update) -> bool:
        if update.apart:
            return update.step()
        with self.weights:
            return update.step()


class _Turn:
    """Holds `lock`; whoever waits for it is served before whoever comes later, so that nobody starves."""

    def __init__(self, gate: AbstractContextManager[Any], lock: threading.Lock) -> None:
        self._gate, self._lock = gate, lock

    def __enter__(self) -> None:
        with self._gate:
            self._lock.acquire()

    def __exit__(self, *exception: object) -> None:
        self._lock.release()


class SecondProcessor:
    """The second processor of the virtual clock: a transition is learned when its cost has passed."""

    def __init__(self) -> None:
        self.taken, self.held = 0, False
        self.update: Update | None = None
        self.gate: AbstractContextManager[Any] = nullcontext()
        self.weights: AbstractContextManager[Any] = nullcontext()
        self._until = 0
        self._timer: asyncio.TimerHandle | None = None

    def start(self, backlog: Backlog, over: Over) -> None:
        """Begin to work."""
        self._backlog, self._over, self._loop = backlog, over, asyncio.get_running_loop()

    def wake(self) -> None:
        """Say that transitions wait."""
        if self.update is None and self._backlog.queue:
            update = self._backlog.take(sliced=False)
            self._learn(update, self._backlog.desk.clock.now() + update.cost)

    def _learn(self, update: Update, until: int) -> None:
        self.update, self._until = update, until
        update.began = until - update.cost
        self.taken += 1
        left = until - self._backlog.desk.clock.now()
        self._timer = self._loop.call_later(left / 1e9, self._finish, update)

    def next_event(self, now: int) -> int | None:
        """Return when (ns) it will be done."""
        return None if self.update is None else self._until

    def settle(self) -> int:
        """Return how many are being learned: in one piece, when the cost has passed."""
        return int(self.update is not None)

    def unsettle(self) -> None:
        """Do nothing: it was not held back."""

    def save(self) -> Saved | None:
        """Return the update whose cost passes, and when (ns) it will have passed."""
        return None if self.update is None else self.update.save() | {"until": self._until}

    def restore(self, saved: Saved | None) -> None:
        """Go on with what was saved."""
        if saved is not None:
            self._learn(self._backlog.again(saved, sliced=False), saved["until"])

    def close(self) -> None:
        """End; what it was doing is left."""
        if self._timer is not None:
            self._timer.cancel()
        self.update = None

    def _finish(self, update: Update) -> None:
        error: Exception | None = None
        try:
            update.step()
        except Exception as raised:
            error = raised
        self.update, update.spent = None, update.cost
        self._over(update, error)
        self.wake()
