"""The transitions that wait to be learned: first in, first out, each once."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any

from rtagent.agent import Agent
from rtagent.checkpoint.plain import restored_transition, save_transition
from rtagent.clock import Clock
from rtagent.experience import Transition
from rtagent.learn import Full, Learn, Where
from rtagent.recorder import Recorder
from rtagent.saving import Saved

IN_PLACE, DEFERRED, UNDER_PRESSURE = "learned_in_place", "learned_deferred", "learned_under_backpressure"


@dataclass
class Desk:
    """What learning needs of the run: its clock and recorder, what a transition costs (ns), and whom to tell.

    `observed_at` says when the newest observation was made: what was complete with it is learned in place.
    Where nothing `costs` anything, `cost` is always 0. `learned_for` is told of slices, and of
    learning elsewhere: from when, to when, and where.
    """

    clock: Clock
    recorder: Recorder
    cost: Callable[[], int]
    observed_at: Callable[[], int]
    learned: Callable[[Transition, float], None]
    failed: Callable[[BaseException], None]
    costs: bool = True
    learned_for: Callable[[int, int, Where], None] | None = None


class Update:
    """A transition being learned: what its cost (ns) says first, then the learner's own work, piece by piece."""

    def __init__(self, learner: Any, transition: Transition, cost: int, sliced: bool) -> None:
        self.transition, self.cost, self.delta = transition, cost, 0.0
        self.began = self.spent = self.pieces = 0
        self.suspended = False
        self.apart = False
        """Whether the piece that follows leaves all action values alone."""
        self._learner = learner
        self._sliced = sliced and hasattr(learner, "updating")
        self._pieces: Generator[bool | None, None, float] | None = None

    @property
    def begun(self) -> bool:
        """Whether the learner has done a piece of it: it cannot be saved then."""
        return self._pieces is not None

    def save(self) -> Saved:
        """Return the transition and what is left of its cost: nothing of it has been learned."""
        return {"transition": save_transition(self.transition), "cost": self.cost, "suspended": self.suspended}

    def step(self) -> bool:
        """Do a piece of the learner's work, or all where it has no pieces; say whether that was the last."""
        if self._pieces is None:
            for move in self.transition.moves:
                self._learner.inherit(*move)
        if not self._sliced:
            self.delta = self._learner.update(self.transition)
            return True
        if self._pieces is None:
            self._pieces = self._learner.updating(self.transition)
        self.pieces += 1
        try:
            self.apart = bool(next(self._pieces))
        except StopIteration as done:
            self.delta = done.value
            return True
        return False


class Backlog:
    """The queue of an agent, the update in progress, and what became of the transitions.

    Learning that raises ends learning: what waits, and what comes, is not learned any more.
    """

    def __init__(self, agent: Agent, rules: Learn, desk: Desk) -> None:
        self.queue: deque[Transition] = agent.queue
        self.rules, self.desk = rules, desk
        self.current: Update | None = None
        self.failed = False
        self.learned = 0
        """How many transitions were learned, but for those that are learned at once."""
        self.update = agent.learner.update
        self._agent, self._counters = agent, desk.recorder.counters

    def __len__(self) -> int:
        return len(self.queue) + (self.current is not None)

    def begin(self, sliced: bool) -> Update:
        """Go on with the update in progress, or begin with the oldest transition; there must be one of both."""
        if self.current is None:
            self.current = self.take(sliced)
        return self.current

    def take(self, sliced: bool) -> Update:
        """Take the oldest transition out of the queue, to learn it."""
        return Update(self._agent.learner, self.queue.popleft(), self.desk.cost(), sliced)

    def again(self, saved: Mapping[str, Any], sliced: bool) -> Update:
        """Return an update that was saved; nothing of it has been learned."""
        update = Update(self._agent.learner, restored_transition(saved["transition"]), saved["cost"], sliced)
        update.suspended = saved["suspended"]
        return update

    def step(self, update: Update) -> bool:
        """Do a piece of an update; say whether it is over: done, or failed."""
        try:
            return update.step()
        except Exception as error:
            self.give_up(error)
            return True

    def end(self, update: Update, how: str = "") -> None:
        """Note that an update is over; `how` is the counter to count it by (else: whether in place)."""
        if self.failed:
            return
        self.current = None
        self.learned += 1
        in_place = not update.suspended and update.transition.complete_at >= self.desk.observed_at()
        self.count(how or (IN_PLACE if in_place else DEFERRED))
        self.desk.learned(update.transition, update.delta)

    def give_up(self, error: BaseException) -> None:
        """End learning, not acting."""
        self.failed, self.current = True, None
        self._agent.keeps_transitions, self._agent.not_kept = False, 0
        self.leave(1 + len(self.queue))
        self.desk.failed(error)

    def count(self, how: str, transitions: int = 1) -> None:
        """Count how transitions were learned."""
        self._counters[how] += transitions

    def leave(self, transitions: int) -> None:
        """Count what is not learned: so many that wait, and what came after learning had failed."""
        self.queue.clear()
        self.count("transitions_not_learned", transitions)
        if self.failed:
            self.count("transitions_not_learned", self._agent.not_kept)
            self._agent.not_kept = 0

    def shed(self) -> None:
        """Drop the newest transition; the traces are cut there."""
        self.queue.pop()
        self._counters["transitions_shed"] += 1
        if self.queue and not self.queue[-1].terminated:
            self.queue[-1].truncated = True

    @property
    def overfull(self) -> bool:
        """Whether more waits than may."""
        return len(self.queue) > self.rules.queue

    @property
    def sheds(self) -> bool:
        """Whether what finds the queue full is dropped."""
        return self.rules.full is Full.SHED
