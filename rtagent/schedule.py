"""Schedules: the cyclic order of act, observe, choose and learn, as data, with the rules that orders obey.

Thesis, chapter 3: `standard` is the order of Algorithm 2 (SARSA), `reactive` that of Algorithm 3.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import NamedTuple, Protocol

from rtagent.errors import ScheduleError
from rtagent.learn import Learn, When, Where
from rtagent.ordering import Ordering
from rtagent.units import ms, us


class Component(StrEnum):
    """One of the four components of an agent; or, where it orders them itself, that decision, and waiting."""

    ACT = "act"
    OBSERVE = "observe"
    CHOOSE = "choose"
    LEARN = "learn"
    ORDER = "order"
    WAIT = "wait"


ACT, OBSERVE, CHOOSE, LEARN, ORDER, WAIT = Component
LISTED = (ACT, OBSERVE, CHOOSE, LEARN)
"""What a list can hold."""
Order = tuple[Component, ...]

STANDARD: Order = (ACT, OBSERVE, CHOOSE, LEARN)
REACTIVE: Order = (OBSERVE, CHOOSE, ACT, LEARN)


INLINE = Learn()


class Preset(NamedTuple):
    """An order, or how one is learned, a learning rule, and a line on them."""

    order: Order
    learn: Learn
    line: str
    ordering: Ordering | None = None


PRESETS: dict[str, Preset] = {
    "standard": Preset(STANDARD, INLINE, "learns before it acts on what it saw (Algorithm 2)"),
    "reactive": Preset(REACTIVE, INLINE, "acts on what it saw at once, then learns (Algorithm 3)"),
    "deferred": Preset(REACTIVE, Learn(when=When.CALM), "learns later what it saw while it was urgent"),
    "interruptible": Preset(REACTIVE, Learn(slice=40 * us), "learns in slices, and leaves off for news"),
    "background": Preset(REACTIVE, Learn(where=Where.THREAD), "learns on a thread of its own"),
    "learned": Preset(REACTIVE, Learn(slice=2 * ms), "learns which of them comes next", Ordering()),
}
FIXED = tuple(name for name, preset in PRESETS.items() if preset.ordering is None)
"""The presets that do the same in every cycle."""


class Situation(Protocol):
    """What a chooser can ask of the run, at any moment."""

    @property
    def time(self) -> int:
        """Now, in ns."""

    @property
    def observed_at(self) -> int:
        """When the newest observation was made, in ns."""

    @property
    def queue_length(self) -> int:
        """How many transitions wait to be learned."""

    @property
    def action_pending(self) -> bool:
        """Whether an action has been chosen that was not yet handed to the devices."""


class Chooser(Protocol):
    """Gives the components of one cycle, one by one; a list is the simplest form (thesis 6.3.1)."""

    def cycle(self, situation: Situation) -> Iterable[Component]:
        """Return the components to run until the cycle ends; a generator may look at `situation` between."""


@dataclass(frozen=True)
class ListChooser:
    """The same list in every cycle."""

    order: Order

    def cycle(self, situation: Situation) -> Iterable[Component]:
        """Return the list."""
        return self.order


class Overrun(StrEnum):
    """What a paced run does after a cycle that took longer than its period."""

    SKIP = "skip"
    CATCH_UP = "catch_up"


class Wait(StrEnum):
    """Whether observe waits for a sample newer than the last, or takes the latest there is."""

    FRESH = "fresh"
    LATEST = "latest"


@dataclass(frozen=True)
class Schedule:
    """In which order the components run, and how the cycle is paced. Times are in ns.

    `learn_delay` is the thesis's simulated cost of learning, charged for each transition learned. `period`
    paces the cycle on absolute deadlines (0: as fast as it goes); after an overrun the missed deadlines are
    skipped or caught up. `observe` waits at most `observe_timeout` for something fresh, then takes the latest.
    With an `ordering` the agent learns which component comes next.
    """

    order: Order
    name: str = "custom"
    learn: Learn = INLINE
    learn_delay: int = 0
    period: int = 0
    overrun: Overrun = Overrun.SKIP
    observe: Wait = Wait.FRESH
    observe_timeout: int = 100_000_000
    ordering: Ordering | None = None
    chooser: Callable[[], Chooser] | None = field(default=None, compare=False)

    @classmethod
    def preset(cls, name: str, **settings: object) -> Schedule:
        """Return a preset by its name, with other settings changed; raise `ScheduleError`."""
        if name not in PRESETS:
            raise ScheduleError(f"there is no preset {name!r}: use one of {', '.join(PRESETS)}.")
        preset = PRESETS[name]
        made = cls(preset.order, name, preset.learn, ordering=preset.ordering)
        return replace(made, **settings)  # type: ignore[arg-type]  # keys are checked by replace

    def __post_init__(self) -> None:
        object.__setattr__(self, "order", parse_order(self.order))
        for name, kind in (("overrun", Overrun), ("observe", Wait)):
            object.__setattr__(self, name, _one_of(kind, getattr(self, name), name))
        for name in ("learn_delay", "period", "observe_timeout"):
            if getattr(self, name) < 0:
                raise ScheduleError(f"schedule.{name} is negative: give a time of 0 or more.")
        if self.ordering is not None:
            self._check_ordering()

    def _check_ordering(self) -> None:
        if self.learn.where is not Where.LOOP or self.learn.when is not When.ALWAYS:
            raise ScheduleError(
                "an agent that learns its ordering decides itself when it learns, on the event loop: "
                'leave learn.when and learn.where out, or give them as "always" and "loop".'
            )
        if self.order != REACTIVE or self.chooser is not None:
            raise ScheduleError("an ordering that is learned takes no order and no chooser: leave them out.")

    @property
    def acts(self) -> bool:
        """Whether it controls anything (else the run only predicts or records)."""
        return ACT in self.order

    @property
    def learns(self) -> bool:
        """Whether learning has a place in it (else the agent is frozen)."""
        return LEARN in self.order

    def make_chooser(self) -> Chooser:
        """Return a chooser for one episode."""
        return self.chooser() if self.chooser else ListChooser(self.order)


def _one_of(kind: type[StrEnum], value: str, name: str) -> StrEnum:
    if value not in list(kind):
        raise ScheduleError(f"schedule.{name} is {value!r}: use one of {', '.join(kind)}.")
    return kind(value)


def parse_order(order: Iterable[str]) -> Order:
    """Return components for their names; raise `ScheduleError` for a name that is none."""
    for name in (parsed := tuple(order)):
        if name not in LISTED:
            raise ScheduleError(f"{str(name)!r} has no place in an order: it holds act, observe, choose and learn.")
    return tuple(Component(name) for name in parsed)


class Fact(StrEnum):
    """Something that holds, or not, between two components."""

    FRESH = "an observation newer than the last choice"
    CHOSEN = "an action that was chosen"
    ACTED = "an act since the last observation"
    COMPLETE = "a newest transition that has its next action"


@dataclass(frozen=True)
class Rule:
    """What a component needs to hold before it, and what holds no more, or newly, after it."""

    component: Component
    needs: frozenset[Fact] = frozenset()
    takes: frozenset[Fact] = frozenset()
    gives: frozenset[Fact] = frozenset()
    only_if: frozenset[Fact] = frozenset()


def rules(needs_next_action: bool) -> tuple[Rule, ...]:
    """Return the table of rules; a learner such as SARSA leaves a transition incomplete until choose."""
    closes = frozenset({Fact.COMPLETE} if needs_next_action else ())
    f = frozenset
    return (
        Rule(ACT, needs=f({Fact.CHOSEN}), gives=f({Fact.ACTED})),
        Rule(OBSERVE, gives=f({Fact.FRESH}), takes=closes, only_if=f({Fact.ACTED})),
        Rule(OBSERVE, gives=f({Fact.FRESH}), takes=f({Fact.ACTED})),
        Rule(CHOOSE, needs=f({Fact.FRESH}), takes=f({Fact.FRESH}), gives=f({Fact.CHOSEN, Fact.COMPLETE})),
        Rule(LEARN, needs=f({Fact.COMPLETE})),
    )


REFUSALS: dict[tuple[Component, Fact], str] = {
    (ACT, Fact.CHOSEN): "act comes before anything was chosen: put observe and choose before it",
    (CHOOSE, Fact.FRESH): "choose needs an observation newer than the last choice: put observe between them",
    (LEARN, Fact.COMPLETE): (
        "learn comes before choose, but this learner learns from the next action (as SARSA does): "
        "put choose between observe and learn, or take a learner that does not need it"
    ),
}

START = frozenset({Fact.COMPLETE})
CYCLES_TO_SETTLE = 3
"""After so many cycles the same facts hold at the beginning of each."""

PROLOGUES: tuple[Order, ...] = ((), (OBSERVE,), (OBSERVE, CHOOSE), (OBSERVE, CHOOSE, OBSERVE))


def prologue(order: Sequence[str], needs_next_action: bool = False) -> Order:
    """Return what must run once before the first cycle of an episode; raise `ScheduleError`.

    It is the shortest of nothing, observe, observe and choose, and observe, choose and observe, after which
    every component of the order finds what it needs, in the first cycle and in all that follow.
    """
    parsed = parse_order(order)
    _check_members(parsed, needs_next_action)
    table = rules(needs_next_action)
    refusal = ""
    for candidate in PROLOGUES:
        if CHOOSE in candidate and CHOOSE not in parsed:
            break
        refusal = _walk(candidate + parsed * CYCLES_TO_SETTLE, table)
        if not refusal:
            return candidate
    raise ScheduleError(f"the order {', '.join(parsed)} cannot work: {refusal}.")


def _check_members(order: Order, needs_next_action: bool) -> None:
    if OBSERVE not in order:
        raise ScheduleError("the order has no observe: an agent that never looks learns and chooses nothing.")
    if (ACT in order) != (CHOOSE in order):
        missing, there = (ACT, CHOOSE) if CHOOSE in order else (CHOOSE, ACT)
        raise ScheduleError(f"the order has {there} but no {missing}: add it, or leave out both to predict only.")

    if needs_next_action and LEARN in order and CHOOSE not in order:
        raise ScheduleError(
            "this learner learns from the next action (as SARSA does), but the order never chooses."
        )


def _walk(order: Order, table: Sequence[Rule]) -> str:
    """Follow the facts through `order`; return the first refusal, or nothing."""
    facts = START
    for component in order:
        before = facts
        for rule in table:
            if rule.component is not component or not rule.only_if <= before:
                continue
            for fact in sorted(rule.needs - before):
                return REFUSALS[component, fact]
            facts = (facts - rule.takes) | rule.gives
    return ""
