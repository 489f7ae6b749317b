"""Schedules: which orders are legal, and what must run before the first cycle."""

from __future__ import annotations

from itertools import product

import pytest
from helpers import REACTIVE, STANDARD, rotations

from rtagent.errors import ScheduleError
from rtagent.schedule import (
    ACT,
    CHOOSE,
    LEARN,
    LISTED,
    OBSERVE,
    PRESETS,
    Component,
    ListChooser,
    Order,
    Overrun,
    Schedule,
    Wait,
    parse_order,
    prologue,
)

LONGEST = 5
CYCLES = 6
ORDERS = [order for length in range(1, LONGEST + 1) for order in product(LISTED, repeat=length)]
POSSIBLE_PROLOGUES = [first for length in range(4) for first in product((OBSERVE, CHOOSE), repeat=length)]
"""Nothing acts in a prologue, so there is never a need for a longer one."""


class Impossible(Exception):  # noqa: N818  # it is no error of the program
    """A component finds nothing to work on."""


class SlowAgent:
    """An agent that keeps its whole history, and looks through it for what every component needs."""

    def __init__(self, needs_next_action: bool) -> None:
        self.needs_next_action = needs_next_action
        self.history: list[Component] = []

    def run(self, component: Component) -> None:
        if component is CHOOSE and not self._has_happened_since(OBSERVE, CHOOSE):
            raise Impossible
        if component is ACT and CHOOSE not in self.history:
            raise Impossible
        if component is LEARN and self.needs_next_action and self._newest_transition_is_incomplete():
            raise Impossible
        self.history.append(component)

    def _has_happened_since(self, event: Component, other: Component) -> bool:
        newest = len(self.history) - 1 - self.history[::-1].index(other) if other in self.history else -1
        return event in self.history[newest + 1 :]

    def _newest_transition_is_incomplete(self) -> bool:
        """Say whether there was an act, then an observe, and no choose since that observe."""
        for place in range(len(self.history) - 1, -1, -1):
            if self.history[place] is CHOOSE:
                return False
            if self.history[place] is OBSERVE and self._closes(place):
                return True
        return False

    def _closes(self, place: int) -> bool:
        """Say whether the observe at `place` is the first one after an act."""
        for component in self.history[:place][::-1]:
            if component is OBSERVE:
                return False
            if component is ACT:
                return True
        return False


def works(order: Order, first: Order, needs_next_action: bool) -> bool:
    agent = SlowAgent(needs_next_action)
    try:
        for component in first + order * CYCLES:
            agent.run(component)
    except Impossible:
        return False
    return True


def shortest_prologue(order: Order, needs_next_action: bool) -> Order | None:
    """Return the shortest prologue that works, or None where the order is illegal."""
    predicts = ACT not in order and CHOOSE not in order
    controls = ACT in order and CHOOSE in order
    if OBSERVE not in order or not (predicts or controls):
        return None
    if predicts:
        return None if needs_next_action and LEARN in order else ()
    candidates = (first for first in POSSIBLE_PROLOGUES if works(order, first, needs_next_action))
    return next(candidates, None)


def derived_prologue(order: Order, needs_next_action: bool) -> Order | None:
    try:
        return prologue(order, needs_next_action)
    except ScheduleError:
        return None


@pytest.mark.parametrize("needs_next_action", [False, True])
def test_every_short_order_is_legal_or_refused_as_a_slow_simulation_says(needs_next_action: bool) -> None:
    differing = {
        order: (derived_prologue(order, needs_next_action), expected)
        for order in ORDERS
        if derived_prologue(order, needs_next_action) != (expected := shortest_prologue(order, needs_next_action))
    }
    assert differing == {}


def test_the_simulation_refuses_some_orders_and_not_others() -> None:
    legal = [order for order in ORDERS if shortest_prologue(order, True) is not None]
    assert {STANDARD, REACTIVE} <= set(legal)
    assert (ACT, OBSERVE, LEARN, CHOOSE) not in legal
    assert len(legal) < len(ORDERS) / 2


@pytest.mark.parametrize(
    ("order", "expected"),
    [
        (STANDARD, (OBSERVE, CHOOSE)),
        (REACTIVE, ()),
        ((CHOOSE, ACT, OBSERVE, LEARN), (OBSERVE,)),
        ((OBSERVE, LEARN), ()),
        ((OBSERVE,), ()),
    ],
)
def test_the_prologue_of_known_orders(order: Order, expected: Order) -> None:
    assert prologue(order) == expected


@pytest.mark.parametrize("needs_next_action", [False, True])
def test_every_rotation_of_an_order_is_as_legal_as_the_order(needs_next_action: bool) -> None:
    differing = [
        order
        for order in ORDERS
        if len({derived_prologue(rotation, needs_next_action) is None for rotation in rotations(order)}) > 1
    ]
    assert differing == []


@pytest.mark.parametrize(
    ("order", "needs_next_action", "sentence"),
    [
        (("act", "choose", "learn"), False, "no observe"),
        (("observe", "choose", "learn"), False, "has choose but no act"),
        (("observe", "act"), False, "has act but no choose"),
        (("observe", "choose", "act", "choose"), False, "newer than the last choice"),
        (("act", "observe", "learn", "choose"), True, "learn comes before choose"),
    ],
)
def test_a_bad_order_is_refused_with_a_sentence(
    order: tuple[str, ...], needs_next_action: bool, sentence: str
) -> None:
    with pytest.raises(ScheduleError, match=sentence) as refusal:
        prologue(order, needs_next_action)
    assert str(refusal.value).endswith(".")


def test_a_learner_that_needs_the_next_action_cannot_only_predict() -> None:
    with pytest.raises(ScheduleError):
        prologue((OBSERVE, LEARN), needs_next_action=True)


def test_an_unknown_component_is_refused_with_the_names_that_there_are() -> None:
    for name in ("plan", "wait", "order"):
        with pytest.raises(ScheduleError, match=rf"'{name}'.*act, observe, choose and learn"):
            parse_order(["observe", name])


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_a_legal_schedule_with_its_name(name: str) -> None:
    schedule = Schedule.preset(name, learn_delay=7)
    assert (schedule.name, schedule.learn_delay) == (name, 7)
    assert schedule.acts
    assert schedule.learns
    assert prologue(schedule.order, needs_next_action=True) is not None


def test_the_presets_are_the_orders_of_the_two_algorithms() -> None:
    assert Schedule.preset("standard").order == STANDARD
    assert Schedule.preset("reactive").order == REACTIVE


def test_an_unknown_preset_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ScheduleError, match="standard, reactive"):
        Schedule.preset("lazy")


@pytest.mark.parametrize("name", ["learn_delay", "period", "observe_timeout"])
def test_a_negative_time_is_refused(name: str) -> None:
    with pytest.raises(ScheduleError, match=name):
        Schedule(REACTIVE, **{name: -1})


def test_a_schedule_takes_components_by_name() -> None:
    schedule = Schedule(("observe", "learn"))  # type: ignore[arg-type]  # scenario files hold strings
    assert schedule.order == (OBSERVE, LEARN)
    assert all(isinstance(component, Component) for component in schedule.order)
    assert (schedule.acts, schedule.learns) == (False, True)
    assert schedule.overrun is Overrun.SKIP


def test_a_schedule_takes_the_other_choices_by_name_too_and_refuses_unknown_ones() -> None:
    schedule = Schedule(REACTIVE, overrun="catch_up", observe="latest")  # type: ignore[arg-type]  # as above
    assert schedule.overrun is Overrun.CATCH_UP
    assert schedule.observe is Wait.LATEST
    for settings in ({"overrun": "hurry"}, {"observe": "never"}):
        with pytest.raises(
            ScheduleError, match=r"'hurry': use one of skip, catch_up|'never': use one of fresh, latest"
        ):
            Schedule(REACTIVE, **settings)  # type: ignore[arg-type]  # as above


def test_schedules_are_values() -> None:
    assert Schedule(REACTIVE) == Schedule(REACTIVE, chooser=lambda: ListChooser(STANDARD))
    assert Schedule(REACTIVE) != Schedule(STANDARD)
    with pytest.raises(AttributeError):
        Schedule(REACTIVE).period = 5  # type: ignore[misc]  # that it cannot be set is the point


def test_a_list_is_the_simplest_chooser() -> None:
    chooser = Schedule(REACTIVE).make_chooser()
    assert chooser == ListChooser(REACTIVE)
    assert tuple(chooser.cycle(None)) == REACTIVE  # type: ignore[arg-type]  # a list does not look


def test_every_episode_gets_a_chooser_of_its_own() -> None:
    schedule = Schedule(REACTIVE, chooser=lambda: ListChooser(STANDARD))
    first, second = schedule.make_chooser(), schedule.make_chooser()
    assert first is not second
    assert tuple(first.cycle(None)) == STANDARD  # type: ignore[arg-type]  # a list does not look
