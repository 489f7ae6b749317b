"""Problems of Sutton and Barto (second edition), and what the book says of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers import one_hot, step

from rtagent.experience import Transition
from rtagent.features import TileCoding
from rtagent.features.tiles import Tilings
from rtagent.learning import TD, Sarsa, TrueOnlineSarsa, TrueOnlineTD
from rtagent.policy import EpsilonGreedy
from rtagent.specs import Spec

# The 19-state random walk (figures 12.6 and 12.8): left end -1, right end 1, no discount

STATES = 19
VALUES = np.arange(-9, 10) / 10
EPISODES, WALKS = 10, 12


@cache
def walks() -> list[list[list[Transition]]]:
    """Return the episodes of every walk: all learners and settings meet the same."""
    rng = np.random.default_rng(7)
    return [[walk(rng) for _ in range(EPISODES)] for _ in range(WALKS)]


def walk(rng: np.random.Generator) -> list[Transition]:
    state, steps = STATES // 2, []
    while 0 <= state < STATES:
        following = state + int(rng.integers(2)) * 2 - 1
        over = not 0 <= following < STATES
        reward = float(np.sign(following - state)) if over else 0.0
        steps.append(step(state, None, reward, min(max(following, 0), STATES - 1), terminated=over))
        state = following
    return steps


@cache
def error(make: Callable[..., Any], lambda_: float, alpha: float) -> float:
    """Return the root mean squared error over the states, averaged over the first ten episodes and all walks."""
    errors = []
    for episodes in walks():
        learner = make(size=STATES, alpha=alpha, gamma=1.0, lambda_=lambda_)
        for episode in episodes:
            for transition in episode:
                learner.update(transition)
            errors.append(math.sqrt(float(((learner.weights - VALUES) ** 2).mean())))
    return float(np.mean(errors))


ALPHAS = (0.1, 0.4, 0.8)


def best(make: Callable[..., Any], lambda_: float) -> float:
    return min(error(make, lambda_, alpha) for alpha in ALPHAS)


@pytest.mark.parametrize("make", [TD, TrueOnlineTD])
def test_on_the_random_walk_an_intermediate_lambda_is_best_at_an_intermediate_alpha(make: type) -> None:
    assert best(make, 0.8) < best(make, 0.0) - 0.04
    assert error(make, 0.8, 0.4) == best(make, 0.8)
    assert 0.22 < best(make, 0.8) < 0.33  # where the lowest curves of both figures run


def test_on_the_random_walk_true_online_td_is_better_and_stays_so_where_td_breaks_down() -> None:
    assert best(TrueOnlineTD, 0.8) < best(TD, 0.8)
    assert error(TD, 0.9, 0.8) > 10
    assert error(TrueOnlineTD, 0.9, 0.8) < 0.5


# Windy gridworld (example 6.5): 10 columns, 7 rows, a wind upwards

WIND = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
COLUMNS, ROWS = 10, 7
START, GOAL = (0, 3), (7, 3)
MOVES = ((0, 1), (0, -1), (1, 0), (-1, 0))


def blown(place: tuple[int, int], action: int) -> tuple[int, int]:
    x, y = place
    dx, dy = MOVES[action]
    return min(max(x + dx, 0), COLUMNS - 1), min(max(y + dy + WIND[x], 0), ROWS - 1)


def cell(place: tuple[int, int]) -> int:
    return place[1] * COLUMNS + place[0]


def windy_steps(learner: Sarsa | TrueOnlineSarsa, policy: EpsilonGreedy, episodes: int) -> list[int]:
    """Return how many steps each episode took."""
    rng, lengths = np.random.default_rng(0), []
    for _ in range(episodes):
        place, length = START, 0
        action, _ = policy.choose(learner.action_values(one_hot(cell(place))), rng)
        while place != GOAL:
            following = blown(place, action)
            next_action, _ = policy.choose(learner.action_values(one_hot(cell(following))), rng)
            learner.update(
                step(cell(place), action, -1.0, cell(following), next_action, terminated=following == GOAL)
            )
            place, action, length = following, next_action, length + 1
        lengths.append(length)
    return lengths


@pytest.mark.parametrize("make", [Sarsa, TrueOnlineSarsa])
def test_sarsa_crosses_the_windy_gridworld_as_in_the_book(make: type) -> None:
    learner = make(size=COLUMNS * ROWS, actions=4, alpha=0.5, gamma=1.0, lambda_=0.0)
    ends = np.cumsum(windy_steps(learner, EpsilonGreedy(), 220))
    assert 140 < int(np.searchsorted(ends, 8000)) < 200  # the figure of the example: some 170 episodes
    patient = make(size=COLUMNS * ROWS, actions=4, alpha=0.1, gamma=1.0, lambda_=0.5)
    lengths = windy_steps(patient, EpsilonGreedy(), 700)
    assert 16 < np.mean(lengths[-200:]) < 19.5  # about 17, with an ε of 0.1; the least is 15


# Mountain car (example 10.1, figure 12.10): 8 tilings of 8 by 8 tiles

CAR = {"position": Spec(low=-1.2, high=0.5), "velocity": Spec(low=-0.07, high=0.07)}


def pushed(position: float, velocity: float, action: int) -> tuple[float, float]:
    velocity = min(max(velocity + 0.001 * (action - 1) - 0.0025 * math.cos(3 * position), -0.07), 0.07)
    position = min(max(position + velocity, -1.2), 0.5)
    return position, 0.0 if position == -1.2 else velocity


def car_steps(make: Callable[..., Any], lambda_: float, alpha: float, episodes: int, seed: int) -> list[int]:
    """Return how many steps each episode took."""
    coder = TileCoding(state=CAR, layers=(Tilings(tilings=8, tiles=8),))
    learner = make(
        size=coder.size, active=coder.active, actions=3, alpha=alpha, divide_alpha=True, gamma=1.0, lambda_=lambda_
    )
    policy, rng, lengths = EpsilonGreedy(epsilon=0.0), np.random.default_rng(seed), []
    for _ in range(episodes):
        state, length = (float(rng.uniform(-0.6, -0.4)), 0.0), 0
        features = coder.encode(state)
        action, _ = policy.choose(learner.action_values(features), rng)
        over = False
        while not over:
            state, length = pushed(*state, action), length + 1
            over, following = state[0] >= 0.5, coder.encode(state)
            next_action, _ = policy.choose(learner.action_values(following), rng)
            learner.update(Transition(features, action, 1.0, -1.0, following, next_action, 0, over, False))
            features, action = following, next_action
        lengths.append(length)
    return lengths


def replacing_sarsa(**settings: Any) -> Sarsa:
    return Sarsa(trace="replacing", **settings)


@pytest.mark.parametrize("make", [replacing_sarsa, TrueOnlineSarsa])
def test_traces_get_the_mountain_car_up_in_fewer_steps_and_in_as_many_as_in_the_book(make: Any) -> None:
    with_traces = np.mean(car_steps(make, 0.9, 0.6, 50, seed=0))
    assert 150 < with_traces < 240  # figure 12.10, replacing traces: 180 to 220 around the best settings
    assert with_traces < np.mean(car_steps(make, 0.0, 0.6, 50, seed=0)) - 20
