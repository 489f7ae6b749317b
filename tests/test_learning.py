"""Learners against steps computed by hand, and against what the textbook says they converge to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import one_hot, step
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning import TD, ExpectedSarsa, QLearning, Sarsa, SwiftTD, TrueOnlineTD
from rtagent.learning.learner import Learner
from rtagent.policy import EpsilonGreedy

# By hand


def test_sarsa_with_accumulating_traces_is_as_computed_by_hand() -> None:
    learner = Sarsa(size=2, actions=2, alpha=0.5, gamma=0.8, lambda_=0.5)
    assert learner.update(step(0, 0, 1.0, 0, 0)) == pytest.approx(1.0)
    # delta 1 + 0.8 * 0 - 0 = 1; the trace of (0, 0) is 1; Q(0, 0) = 0.5 * 1 * 1 = 0.5
    assert learner.weights == pytest.approx(np.array([[0.5, 0.0], [0.0, 0.0]]))
    assert learner.update(step(0, 0, 0.0, 1, 1)) == pytest.approx(-0.5)
    # delta 0 + 0.8 * 0 - 0.5 = -0.5; the trace is 0.8 * 0.5 * 1 + 1 = 1.4; Q(0, 0) = 0.5 - 0.5 * 0.5 * 1.4 = 0.15
    assert learner.weights == pytest.approx(np.array([[0.15, 0.0], [0.0, 0.0]]))
    assert learner.update(step(1, 1, 2.0, 0, 0)) == pytest.approx(2.12)
    # delta 2 + 0.8 * 0.15 - 0 = 2.12; traces: (0, 0) 0.4 * 1.4 = 0.56, (1, 1) 1
    # Q(0, 0) = 0.15 + 0.5 * 2.12 * 0.56 = 0.7436; Q(1, 1) = 0.5 * 2.12 = 1.06
    assert learner.weights == pytest.approx(np.array([[0.7436, 0.0], [0.0, 1.06]]))


def test_sarsa_with_replacing_traces_is_as_computed_by_hand() -> None:
    learner = Sarsa(size=2, actions=2, alpha=0.5, gamma=0.8, lambda_=0.5, trace="replacing")
    learner.update(step(0, 0, 1.0, 0, 0))
    learner.update(step(0, 0, 0.0, 1, 1))
    # as above, but the trace of the second step is 1 and not 1.4; Q(0, 0) = 0.5 - 0.5 * 0.5 * 1 = 0.25
    assert learner.weights == pytest.approx(np.array([[0.25, 0.0], [0.0, 0.0]]))
    assert learner.update(step(1, 1, 2.0, 0, 0)) == pytest.approx(2.2)
    # delta 2 + 0.8 * 0.25 = 2.2; trace of (0, 0) 0.4; Q(0, 0) = 0.25 + 0.5 * 2.2 * 0.4 = 0.69; Q(1, 1) = 1.1
    assert learner.weights == pytest.approx(np.array([[0.69, 0.0], [0.0, 1.1]]))


def test_td_with_accumulating_traces_is_as_computed_by_hand() -> None:
    learner = TD(size=2, alpha=0.5, gamma=0.8, lambda_=0.5)
    assert learner.update(step(0, None, 1.0, 0)) == pytest.approx(1.0)
    # delta 1; trace 1; V(0) = 0.5
    assert learner.update(step(0, None, 0.0, 1)) == pytest.approx(-0.5)
    # delta 0 + 0 - 0.5; trace 0.4 + 1 = 1.4; V(0) = 0.5 - 0.5 * 0.5 * 1.4 = 0.15
    assert learner.update(step(1, None, 2.0, 0)) == pytest.approx(2.12)
    # delta 2 + 0.8 * 0.15 = 2.12; traces 0.56 and 1
    assert learner.weights == pytest.approx(np.array([0.7436, 1.06]))


def test_td_with_replacing_traces_is_as_computed_by_hand() -> None:
    learner = TD(size=2, alpha=0.5, gamma=0.8, lambda_=0.5, trace="replacing")
    learner.update(step(0, None, 1.0, 0))
    learner.update(step(0, None, 0.0, 1))
    # V(0) = 0.5 - 0.5 * 0.5 * 1 = 0.25
    learner.update(step(1, None, 2.0, 0))
    # delta 2 + 0.8 * 0.25 = 2.2; traces 0.4 and 1
    assert learner.weights == pytest.approx(np.array([0.69, 1.1]))


def test_q_learning_is_as_computed_by_hand() -> None:
    learner = QLearning(size=2, actions=2, alpha=0.5, gamma=0.8)
    assert learner.update(step(1, 0, 1.0, 0)) == pytest.approx(1.0)
    # Q(1, 0) = 0.5
    assert learner.update(step(1, 1, -2.0, 0)) == pytest.approx(-2.0)
    # Q(1, 1) = -1
    assert learner.update(step(0, 1, 0.0, 1)) == pytest.approx(0.4)
    # delta 0 + 0.8 * max(0.5, -1) = 0.4; Q(0, 1) = 0.2
    assert learner.update(step(0, 1, 1.0, 1, terminated=True)) == pytest.approx(0.8)
    # delta 1 - 0.2, without the next value; Q(0, 1) = 0.2 + 0.5 * 0.8 = 0.6
    assert learner.weights == pytest.approx(np.array([[0.0, 0.5], [0.6, -1.0]]))


def test_expected_sarsa_is_as_computed_by_hand() -> None:
    policy = EpsilonGreedy(epsilon=0.2)
    learner = ExpectedSarsa(size=2, actions=2, policy=policy, alpha=0.5, gamma=0.8)
    learner.update(step(1, 0, 1.0, 0))
    learner.update(step(1, 1, -2.0, 0))
    # Q(1, ·) = (0.5, -1), of which the policy takes the first with 0.9: 0.9 * 0.5 - 0.1 = 0.35
    assert learner.update(step(0, 1, 0.0, 1)) == pytest.approx(0.28)
    # delta 0.8 * 0.35 = 0.28; Q(0, 1) = 0.14
    assert learner.update(step(0, 1, 1.0, 1, truncated=True)) == pytest.approx(1.14)
    # truncated: delta 1 + 0.28 - 0.14 = 1.14; Q(0, 1) = 0.14 + 0.57 = 0.71
    assert learner.weights == pytest.approx(np.array([[0.0, 0.5], [0.71, -1.0]]))


def test_q_lambda_is_as_computed_by_hand_and_cuts_its_trace_before_an_exploratory_action() -> None:
    learner = QLearning(size=3, actions=2, alpha=0.5, gamma=0.8, lambda_=0.5)
    assert learner.update(step(0, 0, 1.0, 1)) == pytest.approx(1.0)
    # Q(0, 0) = 0.5; its trace decays to 0.4
    assert learner.update(step(1, 0, 1.0, 2)) == pytest.approx(1.0)
    # both actions of 1 are worth 0: greedy; Q(1, 0) = 0.5, Q(0, 0) = 0.5 + 0.5 * 0.4 = 0.7; traces 0.4, 0.16
    assert learner.update(step(1, 1, 2.0, 0)) == pytest.approx(2.56)
    # action 1 of 1 is worth 0, and action 0 is worth 0.5: cut; delta 2 + 0.8 * 0.7; Q(1, 1) = 1.28; trace 0.4
    assert learner.weights == pytest.approx(np.array([[0.7, 0.5, 0.0], [0.0, 1.28, 0.0]]))
    assert learner.update(step(0, 0, 0.3, 1, terminated=True)) == pytest.approx(-0.4)
    # greedy; Q(0, 0) = 0.7 - 0.2 = 0.5; Q(1, 1) = 1.28 - 0.5 * 0.4 * 0.4 = 1.2
    assert learner.weights == pytest.approx(np.array([[0.5, 0.5, 0.0], [0.0, 1.2, 0.0]]))


def test_expected_sarsa_lambda_is_as_computed_by_hand() -> None:
    policy = EpsilonGreedy(epsilon=0.2)
    learner = ExpectedSarsa(size=2, actions=2, policy=policy, alpha=0.5, gamma=0.8, lambda_=0.5)
    learner.update(step(1, 0, 1.0, 0))
    # Q(1, 0) = 0.5, its trace decays to 0.4
    assert learner.update(step(0, 1, 1.0, 1)) == pytest.approx(1.36)
    # the expectation in 1 is 0.9 * 0.5 = 0.45: delta 1 + 0.8 * 0.45; Q(0, 1) = 0.68; Q(1, 0) = 0.5 + 0.272
    assert learner.weights == pytest.approx(np.array([[0.0, 0.772], [0.68, 0.0]]))


def test_features_with_values_are_weighted_by_them() -> None:
    before = FeatureVector(np.array([0, 2]), np.array([0.5, 2.0]))
    after = FeatureVector(np.array([1]), np.array([3.0]))
    transition = Transition(before, 0, 1.0, 1.0, after, 0, 0, False, False)
    td = TD(size=3, alpha=0.1, gamma=0.5, lambda_=0.5, initial=1.0)
    sarsa = Sarsa(size=3, actions=1, alpha=0.1, gamma=0.5, lambda_=0.5, initial=1.0)
    q_learning = QLearning(size=3, actions=1, alpha=0.1, gamma=0.5, initial=1.0)
    for learner in (td, sarsa, q_learning):
        # delta 1 + 0.5 * 3 - (0.5 + 2) = 0; with reward 2 it is 1
        assert learner.update(transition) == pytest.approx(0.0)
        transition.reward = 2.0
        assert learner.update(transition) == pytest.approx(1.0)
        transition.reward = 1.0
    # Q-learning has no trace: 1 + 0.1 * (0.5, 0, 2); the others have 0.25 of the same features in it: 1.25 times
    assert q_learning.weights[0] == pytest.approx(np.array([1.05, 1.0, 1.2]))
    assert td.weights == pytest.approx(np.array([1.0625, 1.0, 1.25]))
    assert sarsa.weights[0] == pytest.approx(td.weights)


@pytest.mark.parametrize("ends", [{"terminated": True}, {"truncated": True}])
def test_traces_are_reset_when_a_last_transition_is_learned(ends: dict[str, bool]) -> None:
    td, sarsa = TD(size=3, lambda_=1.0), Sarsa(size=3, actions=1, lambda_=1.0)
    for learner in (td, sarsa):
        learner.update(step(0, 0, 1.0, 1, 0))
        learner.update(step(1, 0, 1.0, 2, 0, **ends))
        before = np.array(learner.weights).ravel()
        learner.update(step(2, 0, 1.0, 1, 0))
        changed = np.array(learner.weights).ravel() - before
        assert np.flatnonzero(changed).tolist() == [2]


def test_a_truncated_transition_bootstraps_and_a_terminated_one_does_not() -> None:
    learners: list[Learner] = [
        TD(size=2, gamma=0.5, initial=1.0),
        Sarsa(size=2, actions=1, gamma=0.5, initial=1.0),
        QLearning(size=2, actions=1, gamma=0.5, initial=1.0),
        ExpectedSarsa(size=2, actions=1, gamma=0.5, initial=1.0, policy=EpsilonGreedy()),
    ]
    for learner in learners:
        assert learner.update(step(0, 0, 0.0, 1, 0, truncated=True)) == pytest.approx(0.5 * 1 - 1)
    for learner in learners:
        before = learner.update(step(0, 0, 0.0, 1, 0, terminated=True))
        # the value of state 0 has moved from 1 by alpha 0.1 times delta -0.5, and nothing is added to it
        assert before == pytest.approx(-(1 - 0.05))


def test_only_sarsa_needs_the_next_action() -> None:
    assert Sarsa.needs_next_action
    assert not any(learner.needs_next_action for learner in (TD, QLearning, ExpectedSarsa))


@pytest.mark.parametrize("initial", [0, 1, -2])
def test_initial_weights_may_be_whole_numbers(initial: int) -> None:
    learners: list[Learner] = [
        TD(size=2, initial=initial),
        Sarsa(size=2, actions=1, initial=initial),
        QLearning(size=2, actions=1, initial=initial),
        ExpectedSarsa(size=2, actions=1, initial=initial, policy=EpsilonGreedy()),
    ]
    for learner in learners:
        # the value of state 0 is `initial`, alpha is 0.1: what is left of delta after one step is 0.9 of it
        first = learner.update(step(0, 0, 1.0, 1, 0, terminated=True))
        second = learner.update(step(0, 0, 1.0, 1, 0, terminated=True))
        assert first == pytest.approx(1 - initial)
        assert second == pytest.approx(0.9 * first)


@pytest.mark.parametrize(
    "settings", [{"alpha": 0.0}, {"alpha": -1.0}, {"gamma": 1.1}, {"gamma": -0.1}, {"alpha": float("nan")}]
)
def test_steps_and_discounts_out_of_range_are_refused(settings: dict[str, float]) -> None:
    (name,) = settings
    makers: list[Callable[..., Learner]] = [Sarsa, QLearning, ExpectedSarsa, TD]
    for make in makers:
        context: dict[str, object] = {} if make is TD else {"actions": 2}
        context |= {"policy": EpsilonGreedy()} if make is ExpectedSarsa else {}
        with pytest.raises(SpecError, match=name):
            make(size=2, **context, **settings)


@pytest.mark.parametrize("lambda_", [-0.1, 1.1])
def test_a_decay_out_of_range_is_refused(lambda_: float) -> None:
    with pytest.raises(SpecError, match="lambda_"):
        Sarsa(size=2, actions=2, lambda_=lambda_)
    with pytest.raises(SpecError, match="lambda_"):
        TD(size=2, lambda_=lambda_)


@pytest.mark.parametrize("make", [TD, TrueOnlineTD, SwiftTD])
def test_alpha_is_divided_by_the_number_of_active_features_unless_it_is_said(make: Callable[..., Any]) -> None:
    active = Transition(one_hot(0, 1, 2, 3), 0, 1.0, 1.0, one_hot(0), 0, 0, True, False)
    learners = [
        make(size=4, active=4, alpha=0.08, divide_alpha=False),
        make(size=4, active=4, alpha=0.08),
        make(size=4, alpha=0.08),
    ]
    for learner in learners:
        learner.update(active)
    moved = [learner.weights[0] for learner in learners]
    assert moved[1] == pytest.approx(0.02)
    whole = 0.1 / 4 if make is SwiftTD else 0.08  # SwiftTD bounds the sum of all four
    assert moved[0] == moved[2] == pytest.approx(whole)
    with pytest.raises(SpecError, match="active is 0"):
        make(size=4, active=0)


def test_gamma_may_be_said_for_each_second() -> None:
    by_step, by_second = TD(size=2, gamma=0.81, initial=1.0), TD(size=2, gamma=0.9, gamma_per="second", initial=1.0)
    transition = step(0, None, 0.0, 1)
    transition.elapsed = 2_000_000_000
    for _ in range(3):
        assert by_second.update(transition) == pytest.approx(by_step.update(transition))
    transition.elapsed = 0
    assert TD(size=2, gamma=0.9, gamma_per="second", initial=1.0).update(transition) == 0.0
    transition.terminated = True
    assert TD(size=2, gamma=0.9, gamma_per="second", initial=1.0).update(transition) == -1.0


@pytest.mark.parametrize("name", ["gamma", "lambda_"])
@pytest.mark.parametrize("make", [TD, TrueOnlineTD, SwiftTD])
def test_what_functions_of_the_state_give_is_checked(make: Callable[..., Any], name: str) -> None:
    learner = make(size=2, **{name: lambda t: 1.5})
    with pytest.raises(SpecError, match=f"{name} is 1.5"):
        learner.update(step(0, None, 1.0, 1))
    assert not learner.weights.any()


# Against independent references


@given(st.lists(st.tuples(st.sampled_from([0.0, 0.5, 1.0]), st.floats(0, 1), st.floats(-2, 2)), max_size=12))
@settings(max_examples=50)
def test_td_credits_every_earlier_state_by_the_rates_of_the_states_between(
    steps: list[tuple[float, float, float]],
) -> None:
    """Each state is credited with every later delta, times γλ of each state that lies between."""
    rates = [(gamma, lambda_) for gamma, lambda_, _ in steps]
    learner = TD(
        size=5, alpha=0.1, gamma=lambda t: rates[t.elapsed][0], lambda_=lambda t: rates[t.elapsed][1], initial=0.5
    )
    weights = np.full(5, 0.5)
    for now, (gamma, _, reward) in enumerate(steps):
        transition = step(now % 5, None, reward, (now + 1) % 5)
        transition.elapsed = now
        delta = reward + gamma * weights[(now + 1) % 5] - weights[now % 5]
        assert learner.update(transition) == pytest.approx(delta, abs=1e-12)
        for earlier in range(now + 1):
            between = [gamma * lambda_ for gamma, lambda_ in rates[earlier:now]]
            weights[earlier % 5] += 0.1 * delta * np.prod(between)
    np.testing.assert_allclose(learner.weights, weights, rtol=1e-9, atol=1e-12)


def sarsa_by_sums(
    transitions: list[Transition], size: int, actions: int, alpha: float, gamma: float, lambda_: float
) -> FloatArray:
    """SARSA(λ) without a trace: every step is credited to all earlier pairs, (γλ)^k for k steps ago."""
    weights = np.zeros((actions, size))
    episode: list[Transition] = []
    for t in transitions:
        episode.append(t)
        following = 0.0 if t.terminated else weights[t.next_action, t.next_features.indices].sum()
        delta = t.reward + gamma * following - weights[t.action, t.features.indices].sum()
        for ago, earlier in enumerate(reversed(episode)):
            weights[earlier.action, earlier.features.indices] += alpha * delta * (gamma * lambda_) ** ago
        if t.last:
            episode = []
    return weights


@st.composite
def experiences(draw: st.DrawFn) -> list[Transition]:
    states = st.integers(0, 3)
    steps = draw(
        st.lists(st.tuples(states, states, st.floats(-2, 2), st.sampled_from("nnnnte")), min_size=1, max_size=25)
    )
    actions = draw(st.lists(st.integers(0, 1), min_size=len(steps) + 1, max_size=len(steps) + 1))
    return [
        Transition(
            one_hot(state, 4 + state % 2),
            action,
            1.0,
            reward,
            one_hot(following, 4 + following % 2),
            next_action,
            0,
            terminated=end == "t",
            truncated=end == "e",
        )
        for (state, following, reward, end), action, next_action in zip(steps, actions, actions[1:], strict=False)
    ]


@given(experiences(), st.floats(0.01, 0.3), st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=100)
def test_sarsa_credits_every_earlier_pair_of_the_episode(
    experience: list[Transition], alpha: float, gamma: float, lambda_: float
) -> None:
    learner = Sarsa(size=6, actions=2, alpha=alpha, gamma=gamma, lambda_=lambda_)
    for transition in experience:
        learner.update(transition)
    expected = sarsa_by_sums(experience, 6, 2, alpha, gamma, lambda_)
    assert learner.weights == pytest.approx(expected, rel=1e-9, abs=1e-12)


@given(experiences(), st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=50)
def test_td_is_sarsa_with_one_action(experience: list[Transition], gamma: float, lambda_: float) -> None:
    for transition in experience:
        transition.action = transition.next_action = 0
    td = TD(size=6, gamma=gamma, lambda_=lambda_)
    sarsa = Sarsa(size=6, actions=1, gamma=gamma, lambda_=lambda_)
    assert [td.update(each) for each in experience] == [sarsa.update(each) for each in experience]


@given(experiences())
@settings(max_examples=50)
def test_expected_sarsa_under_a_greedy_policy_is_q_learning(experience: list[Transition]) -> None:
    q_learning = QLearning(size=6, actions=2)
    expected = ExpectedSarsa(size=6, actions=2, policy=EpsilonGreedy(epsilon=0.0))
    assert [q_learning.update(each) for each in experience] == pytest.approx(
        [expected.update(each) for each in experience]
    )


# What they converge to


def random_walk(rng: Generator) -> list[Transition]:
    """Walk over states 0 to 4 from the middle; the reward is 1 at the right end, else 0."""
    state, walk = 2, []
    while 0 <= state <= 4:
        following = state + int(rng.integers(2)) * 2 - 1
        over = not 0 <= following <= 4
        walk.append(step(state, None, float(following == 5), min(max(following, 0), 4), terminated=over))
        state = following
    return walk


@pytest.mark.parametrize("lambda_", [0.0, 0.5, 1.0])
def test_td_finds_the_chances_of_a_random_walk(lambda_: float) -> None:
    rng, learner, average = (
        np.random.default_rng(3),
        TD(size=5, alpha=0.02, gamma=1.0, lambda_=lambda_),
        np.zeros(5),
    )
    for episode in range(2500):
        for transition in random_walk(rng):
            learner.update(transition)
        average += learner.weights / 2000 * (episode >= 500)
    assert average == pytest.approx(np.arange(1, 6) / 6, abs=0.03)


SIDE, GOAL = 4, 15
MOVES = ((0, -1), (0, 1), (-1, 0), (1, 0))
WALLS = {5, 6, 9}


def move(place: int, action: int) -> int:
    """Return the next cell of a grid with walls; what is in the way stops the move."""
    x, y = place % SIDE + MOVES[action][0], place // SIDE + MOVES[action][1]
    following = y * SIDE + x
    return following if 0 <= x < SIDE and 0 <= y < SIDE and following not in WALLS else place


def distances() -> dict[int, int]:
    """Return how far every cell is from the goal, by breadth-first search."""
    found, frontier = {GOAL: 0}, deque([GOAL])
    while frontier:
        place = frontier.popleft()
        for before in range(SIDE * SIDE):
            leads_here = before not in WALLS and place in (move(before, action) for action in range(4))
            if leads_here and before not in found:
                found[before] = found[place] + 1
                frontier.append(before)
    return found


def sarsa_episode(learner: Sarsa, policy: EpsilonGreedy, rng: Generator) -> None:
    place = 0
    action, _ = policy.choose(learner.action_values(one_hot(place)), rng)
    while place != GOAL:
        following = move(place, action)
        next_action, _ = policy.choose(learner.action_values(one_hot(following)), rng)
        learner.update(step(place, action, -1.0, following, next_action, terminated=following == GOAL))
        place, action = following, next_action


def greedy_path(learner: Sarsa | QLearning, place: int) -> int:
    """Return how many greedy moves it takes to the goal (at most 100)."""
    for taken in range(100):
        if place == GOAL:
            return taken
        place = move(place, int(learner.action_values(one_hot(place)).argmax()))
    return 100


def test_sarsa_finds_the_shortest_path_through_a_small_grid() -> None:
    learner = Sarsa(size=SIDE * SIDE, actions=4, alpha=0.2, gamma=1.0, lambda_=0.5)
    policy, rng = EpsilonGreedy(epsilon=0.1), np.random.default_rng(0)
    for _ in range(300):
        sarsa_episode(learner, policy, rng)
    assert greedy_path(learner, 0) == distances()[0] == 6


def test_q_learning_finds_the_best_values_from_random_behaviour() -> None:
    learner = QLearning(size=SIDE * SIDE, actions=4, alpha=1.0, gamma=0.9)
    places = [place for place in distances() if place != GOAL]
    for _ in range(12):
        for place in places:
            for action in range(4):
                following = move(place, action)
                learner.update(step(place, action, -1.0, following, terminated=following == GOAL))
    for place in places:
        # the discounted sum of -1 over as many steps as the goal is away
        best = -sum(0.9**k for k in range(distances()[place]))
        assert learner.action_values(one_hot(place)).max() == pytest.approx(best)
        assert greedy_path(learner, place) == distances()[place]


def test_expected_sarsa_finds_the_values_of_its_policy() -> None:
    learner = ExpectedSarsa(size=SIDE * SIDE, actions=4, alpha=1.0, gamma=0.9, policy=EpsilonGreedy(epsilon=1.0))
    places = [place for place in distances() if place != GOAL]
    for _ in range(150):
        for place in places:
            for action in range(4):
                following = move(place, action)
                learner.update(step(place, action, -1.0, following, terminated=following == GOAL))
    # the values of uniform behaviour solve V = -1 + 0.9 P V, the goal being worth nothing
    chances = np.array([[sum(move(a, b) == c for b in range(4)) / 4 for c in places] for a in places])
    values = np.linalg.solve(np.eye(len(places)) - 0.9 * chances, -np.ones(len(places)))
    learned = [learner.action_values(one_hot(place)).mean() for place in places]
    assert learned == pytest.approx(values.tolist(), abs=1e-6)
