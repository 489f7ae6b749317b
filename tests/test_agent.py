"""The agent's bookkeeping: from observations, choices and acts to transitions."""

from __future__ import annotations

from itertools import count, pairwise, product

import numpy as np
import pytest
from helpers import REACTIVE, STANDARD, learn, one_hot, rotations
from numpy.random import Generator

from rtagent.agent import Agent
from rtagent.errors import ScheduleError
from rtagent.experience import FeatureVector, FloatArray, Outcome, State, Transition
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, Component, Order, prologue


class Places:
    """Codes a state by its one number; counts how often it is asked."""

    size, active = 1000, 1

    def __init__(self) -> None:
        self.asked = 0

    def encode(self, state: State) -> FeatureVector:
        self.asked += 1
        return one_hot(int(state[0]))


class Notes:
    """A learner that only notes what it is given."""

    def __init__(self, needs_next_action: bool = False) -> None:
        self.needs_next_action = needs_next_action
        self.learned: list[Transition] = []

    def update(self, transition: Transition) -> float:
        self.learned.append(transition)
        return transition.reward

    def action_values(self, features: FeatureVector) -> FloatArray:
        return np.zeros(10)


class Counted:
    """A policy that takes action 0, then 1, and so on, each with a probability of its own."""

    def __init__(self) -> None:
        self._numbers = count()

    def choose(self, action_values: FloatArray, rng: Generator) -> tuple[int, float]:
        action = next(self._numbers)
        return action, 1 / (action + 2)

    def probabilities(self, action_values: FloatArray) -> FloatArray:
        return np.ones(10) / 10


def agent_of(needs_next_action: bool = False, policy: Counted | None = None) -> Agent:
    return Agent(Places(), Notes(needs_next_action), policy or Counted())


def see(
    agent: Agent,
    place: int,
    reward: float = 0.0,
    *,
    time: int = 0,
    terminated: bool = False,
    truncated: bool = False,
) -> Transition | None:
    return agent.observe(Outcome((float(place),), reward, terminated, truncated), time)


def summary(transition: Transition) -> tuple[int, int | None, float, int, int | None]:
    """Return S, A, R, S', A'."""
    (state,), (following,) = transition.features.indices, transition.next_features.indices
    return int(state), transition.action, transition.reward, int(following), transition.next_action


def queued(agent: Agent) -> list[tuple[int, int | None, float, int, int | None]]:
    return [summary(transition) for transition in agent.queue]


def test_the_reactive_order_gives_the_transitions_of_algorithm_3() -> None:
    agent = agent_of(needs_next_action=True)
    see(agent, 10, time=100)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0, time=130)
    assert not agent.queue
    agent.choose()
    agent.acted()
    assert queued(agent) == [(10, 0, -1.0, 11, 1)]
    see(agent, 12, -2.0, time=170, terminated=True)
    assert queued(agent) == [(10, 0, -1.0, 11, 1), (11, 1, -2.0, 12, None)]
    assert [(t.elapsed, t.probability, t.last) for t in agent.queue] == [(30, 1 / 2, False), (40, 1 / 3, True)]


def test_a_transition_is_complete_at_observe_where_the_next_action_is_not_needed() -> None:
    agent = agent_of()
    see(agent, 10)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0)
    assert queued(agent) == [(10, 0, -1.0, 11, None)]


def test_a_second_observation_without_an_act_refreshes_and_adds_nothing() -> None:
    agent = agent_of(needs_next_action=True)
    see(agent, 10, time=0)
    agent.choose()
    agent.acted()
    assert see(agent, 11, -1.0, time=10) is not None
    assert see(agent, 12, -2.0, time=25) is None
    agent.choose()
    assert queued(agent) == [(10, 0, -3.0, 12, 1)]
    assert agent.queue[0].elapsed == 25


def test_rewards_of_a_refreshing_observation_are_not_lost_where_the_transition_is_complete() -> None:
    agent = agent_of()
    see(agent, 10)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0)
    see(agent, 12, -2.0)
    agent.choose()
    agent.acted()
    see(agent, 13, -4.0)
    assert queued(agent) == [(10, 0, -1.0, 11, None), (12, 1, -6.0, 13, None)]


def test_an_action_is_learned_with_the_state_that_it_was_chosen_from() -> None:
    agent = agent_of()
    see(agent, 10, time=100)
    agent.choose()
    see(agent, 11, time=110)
    agent.acted()
    see(agent, 12, time=130)
    assert queued(agent) == [(10, 0, 0.0, 12, None)]
    assert agent.queue[0].elapsed == 30


def test_a_terminal_refresh_completes_a_transition_without_a_next_action() -> None:
    agent = agent_of(needs_next_action=True)
    see(agent, 10)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0)
    see(agent, 12, -2.0, terminated=True)
    assert queued(agent) == [(10, 0, -3.0, 12, None)]
    assert agent.queue[0].terminated
    assert not agent.awaits_next_action


def test_a_truncated_transition_waits_for_its_next_action_where_that_is_needed() -> None:
    agent = agent_of(needs_next_action=True)
    see(agent, 10)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0, truncated=True)
    assert agent.awaits_next_action
    agent.choose()
    assert queued(agent) == [(10, 0, -1.0, 11, 1)]
    assert agent.queue[0].truncated
    assert not agent.queue[0].terminated


@pytest.mark.parametrize("needs_next_action", [False, True])
def test_an_end_that_comes_before_the_next_act_is_learned_under_the_action_in_force(
    needs_next_action: bool,
) -> None:
    agent = agent_of(needs_next_action)
    see(agent, 10, time=0)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0, time=10)
    agent.choose()
    see(agent, 12, -2.0, time=30, terminated=True)
    assert [summary(each)[:4] for each in agent.queue] == [(10, 0, -1.0, 11), (11, 0, -2.0, 12)]
    assert [each.elapsed for each in agent.queue] == [10, 20]


def test_an_end_before_anything_was_done_is_no_transition() -> None:
    agent = agent_of()
    assert see(agent, 10, terminated=True) is None
    assert not agent.queue


def test_an_action_that_is_repeated_in_a_new_state_is_learned_there() -> None:
    agent = agent_of()
    see(agent, 10, time=100)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0, time=110)
    agent.acted()
    see(agent, 12, -2.0, time=130)
    assert queued(agent) == [(10, 0, -1.0, 11, None), (11, 0, -2.0, 12, None)]
    assert [each.elapsed for each in agent.queue] == [10, 20]


def test_an_action_that_is_repeated_in_a_new_state_is_the_next_action_of_the_transition_before() -> None:
    agent = agent_of(needs_next_action=True)
    see(agent, 10, time=100)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0, time=110)
    agent.acted()
    see(agent, 12, -2.0, time=130)
    agent.choose()
    assert queued(agent) == [(10, 0, -1.0, 11, 0), (11, 0, -2.0, 12, 1)]
    assert [each.elapsed for each in agent.queue] == [10, 20]


def test_an_action_sent_twice_without_a_look_between_is_one_transition() -> None:
    agent = agent_of()
    see(agent, 10)
    agent.choose()
    agent.acted()
    agent.acted()
    see(agent, 11, -1.0)
    assert queued(agent) == [(10, 0, -1.0, 11, None)]


def test_without_a_policy_every_observation_closes_a_transition() -> None:
    agent = Agent(Places(), Notes())
    see(agent, 10, time=0)
    see(agent, 11, 1.0, time=5)
    see(agent, 12, 2.0, time=15, terminated=True)
    assert queued(agent) == [(10, None, 1.0, 11, None), (11, None, 2.0, 12, None)]
    assert [each.elapsed for each in agent.queue] == [5, 10]


def test_features_are_computed_once_for_each_observation() -> None:
    agent = agent_of(needs_next_action=True)
    for place in range(5):
        see(agent, place)
        agent.choose()
        agent.acted()
    assert isinstance(agent.features, Places)
    assert agent.features.asked == 5
    assert all(first.next_features is second.features for first, second in pairwise(agent.queue))


def test_choosing_twice_from_one_observation_is_refused() -> None:
    agent = agent_of()
    with pytest.raises(ScheduleError):
        agent.choose()
    see(agent, 10)
    agent.choose()
    with pytest.raises(ScheduleError):
        agent.choose()


def test_an_agent_without_a_policy_cannot_choose() -> None:
    agent = Agent(Places(), Notes())
    see(agent, 10)
    with pytest.raises(ScheduleError):
        agent.choose()


def test_an_action_is_pending_from_its_choice_to_its_act() -> None:
    agent = agent_of()
    see(agent, 10)
    pending = [agent.action_pending]
    agent.choose()
    pending.append(agent.action_pending)
    agent.acted()
    pending.append(agent.action_pending)
    see(agent, 11)
    pending.append(agent.action_pending)
    assert pending == [False, True, False, False]


def test_an_action_is_a_repetition_where_it_is_the_one_in_force_already() -> None:
    class Stubborn(Counted):
        def choose(self, action_values: FloatArray, rng: Generator) -> tuple[int, float]:
            number, probability = super().choose(action_values, rng)
            return (0, 0, 1, 1)[number], probability

    agent = agent_of(policy=Stubborn())
    repeats = [agent.repeats_action]
    for place in range(4):
        see(agent, place)
        agent.choose()
        repeats.append(agent.repeats_action)
        agent.acted()
        assert agent.repeats_action
    # nothing is pending at first; then action 0, the same again, action 1, the same again
    assert repeats == [True, False, True, False, True]


def test_an_episode_begins_without_anything_of_the_last_but_its_queue() -> None:
    agent = agent_of()
    see(agent, 10)
    agent.choose()
    agent.acted()
    see(agent, 11, -1.0)
    agent.choose()
    agent.acted()
    agent.begin()
    assert agent.chosen is None
    assert see(agent, 20, -7.0) is None
    agent.choose()
    agent.acted()
    see(agent, 21, -2.0)
    assert [summary(each)[::3] for each in agent.queue] == [(10, 11), (20, 21)]


def test_transitions_are_learned_in_their_order_and_each_once() -> None:
    agent = agent_of()
    see(agent, 10)
    for place in range(11, 15):
        agent.choose()
        agent.acted()
        see(agent, place, -float(place))
    expected = list(agent.queue)
    learned = [learn(agent) for _ in range(len(expected))]
    assert [transition for transition, _ in learned] == expected
    assert [delta for _, delta in learned] == [transition.reward for transition in expected]
    assert not agent.queue


def test_an_agent_that_never_learns_keeps_no_transitions() -> None:
    agent = agent_of()
    agent.keeps_transitions = False
    see(agent, 10)
    agent.choose()
    agent.acted()
    assert see(agent, 11) is not None
    assert not agent.queue


# Whatever the order


def follow(order: Order, needs_next_action: bool, cycles: int = 8) -> tuple[list[Transition], float, int]:
    """Run an order until an end; return what was learned, the reward of all, and how often an act was seen."""
    agent, places, closed, acted, total = agent_of(needs_next_action), count(1), 0, False, 0.0
    components = list(prologue(order, needs_next_action) + order * cycles)
    while components[-1] is not OBSERVE:
        components.pop()
    for number, component in enumerate(components):
        if component is OBSERVE:
            place = next(places)
            closed, acted, total = closed + acted, False, total + 2.0**-place
            see(agent, place, 2.0**-place, time=10 * place, terminated=number == len(components) - 1)
        elif component is CHOOSE:
            agent.choose()
        elif component is ACT:
            agent.acted()
            acted = True
    learned = [learn(agent)[0] for _ in range(len(agent.queue))]
    return learned, total, closed


def is_legal(order: Order, needs_next_action: bool) -> bool:
    try:
        prologue(order, needs_next_action)
    except ScheduleError:
        return False
    return True


@pytest.mark.parametrize("needs_next_action", [False, True])
def test_no_legal_order_loses_a_transition_or_a_reward(needs_next_action: bool) -> None:
    wrong = []
    for order in (each for length in range(3, 6) for each in product(Component, repeat=length)):
        if ACT in order and is_legal(order, needs_next_action):
            learned, total, closed = follow(order, needs_next_action)
            rewards = sum(transition.reward for transition in learned)
            # the end closes one more where no act came before it
            if rewards != total or len(learned) - closed not in (0, 1):
                wrong.append(order)
    assert wrong == []


@pytest.mark.parametrize("order", rotations(STANDARD) + rotations(REACTIVE))
@pytest.mark.parametrize("needs_next_action", [False, True])
def test_each_transition_begins_where_the_last_ended(order: Order, needs_next_action: bool) -> None:
    learned, _, _ = follow(order, needs_next_action)
    assert len(learned) >= 7
    for first, second in pairwise(learned):
        assert first.next_features is second.features
        assert second.elapsed > 0
        assert not needs_next_action or first.next_action == second.action
        assert not first.last
    assert learned[-1].terminated


def test_the_next_action_is_the_one_that_was_chosen_in_the_next_state() -> None:
    orders = [*rotations(STANDARD), *rotations(REACTIVE), *rotations((OBSERVE, ACT, CHOOSE, LEARN))]
    for order in orders:
        learned, _, _ = follow(order, needs_next_action=True)
        # the policy takes action 0 in the first state that it is asked in, which is number 1, and so on
        inner = [summary(transition)[3:] for transition in learned if not transition.last]
        assert inner == [(state, state - 1) for state, _ in inner], order


def test_learning_is_no_part_of_what_is_experienced() -> None:
    frozen = tuple(component for component in REACTIVE if component is not LEARN)
    learning, frozen_one = ([summary(each) for each in follow(order, True)[0]] for order in (REACTIVE, frozen))
    assert learning == frozen_one
