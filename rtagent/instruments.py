"""Instruments: hooks that receive timestamps. They write to preallocated arrays and cannot break a run."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rtagent.experience import Command, Observation, Stimulus, Transition
from rtagent.learn import Where
from rtagent.reaction import Reaction
from rtagent.recorder import EpisodeRecord
from rtagent.schedule import Component

log = logging.getLogger("rtagent")


class Instrument:
    """The hooks, all optional: any object that has some of these methods is an instrument.

    Times are in ns. During a cycle hooks are called after the act, never between an observation and its action.
    A hook that raises is removed for the rest of the run, and logged.
    """

    def run_began(self, report: Callable[[str, str], None]) -> None:
        """A run began; `report(source, message)` tells it of a fault that does not end it, on its event loop."""

    def counting_began(self, counts: Callable[[], Mapping[str, int]]) -> None:
        """A run began; `counts()` returns, at any time, what was dropped, retried or late so far, by name."""

    def trial_began(self, trial: int, agent: Any) -> None:
        """A trial began, with this `rtagent.Agent`."""

    def noted(self, calls: Sequence[tuple[str, tuple[Any, ...]]]) -> None:
        """A cycle was over: all its calls at once, as names of hooks with their arguments, before they are made.

        For an instrument that has no time for a call each. The list may be kept, but not changed.
        """

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """An episode began."""

    def observed(self, observation: Observation, stimuli: Sequence[Stimulus]) -> None:
        """The agent observed; `stimuli` are those that this observation is the first to contain."""

    def had_learned(self, transitions: int, pieces: int) -> None:
        """So much was learned at the choice that follows: whole transitions, and pieces of the next one.

        It is told to an instrument that hears `chose`.
        """

    def chose(self, action: int, probability: float, time: int) -> None:
        """The agent chose an action."""

    def acted(self, action: int, sent: Mapping[str, Command], start: int, end: int) -> None:
        """An action was handed to the devices; `sent` is what each of them really took."""

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        """A transition was learned."""

    def component(self, component: Component, start: int, end: int) -> None:
        """A component ran; learning in slices or elsewhere is told by `learned_for` instead."""

    def learned_for(self, start: int, end: int, where: Where) -> None:
        """A slice of learning ran on the loop, or a whole transition elsewhere."""

    def reacted(self, reaction: Reaction) -> None:
        """A stimulus got its first reaction."""

    def trial_ended(self, trial: int, agent: Any) -> None:
        """A trial ended, and its `rtagent.Agent` has learned all that it will."""

    def fault(self, source: str, message: str, time: int) -> None:
        """Something failed."""

    def episode_ended(self, record: EpisodeRecord) -> None:
        """An episode ended."""


NOTED = ("observed", "had_learned", "chose", "acted", "learned", "component", "reacted")
"""The hooks whose calls are kept until the act is over, as those of `learned_for` are where it is heard singly."""
HOOKS = tuple(name for name in vars(Instrument) if not name.startswith("_"))


class Hooks:
    """Calls every instrument that has a hook; one that raises is removed."""

    def __init__(self, instruments: Iterable[object]) -> None:
        instruments = list(instruments)
        self._calls: dict[str, list[Callable[..., None]]] = {
            name: [hook for instrument in instruments if (hook := _own_hook(instrument, name)) is not None]
            for name in HOOKS
        }
        heard = {name for name, calls in self._calls.items() if calls}
        self.heard = frozenset(heard.union(NOTED) if "noted" in heard else heard)
        self._heard_singly = not heard.isdisjoint((*NOTED, "learned_for"))
        self.removed: list[str] = []
        self.noted: list[tuple[str, tuple[Any, ...]]] = []
        self.note = self.noted.append
        """Keeps a call, the name and its arguments, for later; worth it only where the name is among `heard`."""

    def tell(self) -> None:
        """Make the calls that were kept, in order."""
        noted = self.noted.copy()
        self.noted.clear()
        if self._calls["noted"]:
            known = [call for call in noted if call[0] in NOTED] if self._calls["learned_for"] else noted
            self.call("noted", known)
        if self._heard_singly:
            for name, args in noted:
                self.call(name, *args)

    def call(self, name: str, *args: Any) -> None:
        """Call the hook `name` of every instrument, now."""
        for hook in self._calls[name]:
            try:
                hook(*args)
            except Exception as error:
                self._remove(name, hook, error)

    def _remove(self, name: str, hook: Callable[..., None], error: Exception) -> None:
        owner = type(getattr(hook, "__self__", hook)).__name__
        sentence = f"the instrument {owner} raised {error!r} in its hook {name!r} and was taken off that hook"
        log.exception("%s; the run goes on.", sentence)
        self.removed.append(sentence)
        self._calls[name] = [other for other in self._calls[name] if other is not hook]


def _own_hook(instrument: object, name: str) -> Callable[..., None] | None:
    hook = getattr(instrument, name, None)
    if hook is None or getattr(hook, "__func__", None) is vars(Instrument)[name]:
        return None
    made: Callable[..., None] = hook
    return made
