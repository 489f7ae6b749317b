"""What the runtime asks of learning, and which kind a learning rule makes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

from rtagent.backlog.backlog import Backlog
from rtagent.backlog.elsewhere import Elsewhere
from rtagent.backlog.in_loop import Inline, InLoop
from rtagent.backlog.processors import LearnerThread, SecondProcessor
from rtagent.learn import Where
from rtagent.saving import Saved
from rtagent.senses import Senses
from rtagent.urgency import Urgency

OnThread = Callable[[], None] | None


class Work(Protocol):
    """Learns the transitions of an agent, first in, first out, each once."""

    backlog: Backlog
    weights: AbstractContextManager[Any]
    """Within it nothing learns: the weights are those of whole pieces of work."""
    called: bool
    """Whether learning has just left off for something that a round of the event loop has brought."""

    @property
    def length(self) -> int:
        """How many transitions wait or are being learned."""

    @property
    def progress(self) -> tuple[int, int]:
        """How many transitions were learned, and how many pieces of the next one."""

    def oldest_age(self, now: int) -> int:
        """Return for how long (ns) the oldest transition has waited."""

    async def learn(self) -> None:
        """Learn, as the rule says; the schedule has come to it."""

    async def relieve(self) -> None:
        """See to it that no more transitions wait than may."""

    async def drain(self, deadline: int | None) -> None:
        """Learn what is left until `deadline` (ns; None: all of it); the rest is counted."""

    def next_event(self, now: int) -> int | None:
        """Return when (ns) learning will have got further by itself, where that is known."""

    def close(self) -> None:
        """End learning."""

    def settle(self, wait: bool) -> bool:
        """Say whether nothing is half learned, so that it can be saved; `wait`: see to it, if it can be done now.

        Until `unsettle` nothing more is begun elsewhere.
        """

    def unsettle(self) -> None:
        """Let learning go on."""

    def save(self) -> Saved:
        """Return what is being learned, and what was counted; the queue is the agent's."""

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""


def make_work(
    backlog: Backlog,
    senses: Senses,
    urgency: Urgency,
    *,
    virtual: bool,
    on_thread: OnThread = None,
    once: bool = False,
) -> Work:
    """Return what learns by the rules of the backlog, on the loop a slice at a time where only `once` is told to.

    A thread calls `on_thread` when it begins.
    """
    rules = backlog.rules
    if rules.where is Where.THREAD:
        return Elsewhere(backlog, senses, SecondProcessor() if virtual else LearnerThread(on_thread))
    return Inline(backlog) if rules.inline and not once else InLoop(backlog, senses, urgency, once=once)
