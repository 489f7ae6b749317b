"""Windy gridworld and cliff walking (Sutton and Barto, 2nd edition, examples 6.5 and 6.6, figure 6.3).

Beside the published figures stand exact ones: the best values of a policy that explores, and of one that does not,
solved by dynamic programming.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from helpers import one_hot, step
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.learning import ExpectedSarsa, QLearning, Sarsa
from rtagent.policy import EpsilonGreedy

pytestmark = pytest.mark.slow

EPSILON = 0.1
MOVES = ((0, 1), (0, -1), (-1, 0), (1, 0))  # up, down, left, right
Step = Callable[[int, int], tuple[int, float]]
Learner = Sarsa | ExpectedSarsa | QLearning

WIND = (0, 0, 0, 1, 1, 1, 2, 2, 1, 0)
WINDY_START, WINDY_GOAL, WINDY_SIZE = 30, 37, 70
CLIFF_START, CLIFF_GOAL, CLIFF_SIZE = 0, 11, 48


def windy(cell: int, action: int) -> tuple[int, float]:
    """Move on the grid of 10 × 7; the wind of the column that is left pushes upwards."""
    x, y = cell % 10 + MOVES[action][0], cell // 10 + MOVES[action][1] + WIND[cell % 10]
    return min(max(x, 0), 9) + 10 * min(max(y, 0), 6), -1.0


def cliff(cell: int, action: int) -> tuple[int, float]:
    """Move on the grid of 12 × 4; the cliff costs 100 and leads back to the start."""
    x, y = min(max(cell % 12 + MOVES[action][0], 0), 11), min(max(cell // 12 + MOVES[action][1], 0), 3)
    return (CLIFF_START, -100.0) if y == 0 and 0 < x < 11 else (x + 12 * y, -1.0)


def best_values(world: Step, size: int, goal: int, epsilon: float) -> NDArray[np.float64]:
    """Return the action values, shape (size, 4), of the best policy that explores with `epsilon`."""
    following = np.array([[world(cell, action)[0] for action in range(4)] for cell in range(size)])
    rewards = np.array([[world(cell, action)[1] for action in range(4)] for cell in range(size)])
    q = np.zeros((size, 4))
    for _ in range(3000):
        values = (1 - epsilon) * q.max(axis=1) + epsilon * q.mean(axis=1)
        values[goal] = 0.0
        q = rewards + values[following]
    return q


def best_return(world: Step, size: int, start: int, goal: int, epsilon: float) -> float:
    q = best_values(world, size, goal, epsilon)[start]
    return float((1 - epsilon) * q.max() + epsilon * q.mean())


def learn_episode(learner: Learner, world: Step, start: int, goal: int, rng: Generator) -> tuple[float, int]:
    """Learn an episode of ε-greedy behaviour; return the sum of its rewards, and its steps."""
    policy, cell, total = EpsilonGreedy(epsilon=EPSILON), start, 0.0
    action, _ = policy.choose(learner.action_values(one_hot(cell)), rng)
    for steps in range(1, 20_000):
        following, reward = world(cell, action)
        total, over = total + reward, following == goal
        next_action, _ = policy.choose(learner.action_values(one_hot(following)), rng)
        learner.update(step(cell, action, reward, following, next_action, terminated=over))
        if over:
            return total, steps
        if not learner.needs_next_action:  # it chooses from what it has just learned
            next_action, _ = policy.choose(learner.action_values(one_hot(following)), rng)
        cell, action = following, next_action
    pytest.fail("an episode without end")


def greedy_return(learner: Learner, world: Step, start: int, goal: int) -> float:
    """Return the sum of rewards of the greedy way, or -inf where it goes in circles."""
    cell, total = start, 0.0
    for _ in range(100):
        cell, reward = world(cell, int(learner.action_values(one_hot(cell)).argmax()))
        total += reward
        if cell == goal:
            return total
    return -np.inf


def band(found: NDArray[np.float64]) -> float:
    """Return three standard errors of the mean."""
    return float(3 * found.std(ddof=1) / np.sqrt(len(found)))


# Windy gridworld


def windy_learner(alpha: float) -> Sarsa:
    return Sarsa(size=WINDY_SIZE, actions=4, alpha=alpha, gamma=1.0, lambda_=0.0)


def walk_windily(learner: Sarsa, rng: Generator, steps: int) -> list[int]:
    """Return the lengths of the episodes that ended within so many steps."""
    lengths: list[int] = []
    while True:
        length = learn_episode(learner, windy, WINDY_START, WINDY_GOAL, rng)[1]
        if sum(lengths) + length > steps:
            return lengths
        lengths.append(length)


def test_the_exact_values_of_the_windy_gridworld_are_those_of_the_example() -> None:
    """The shortest way takes 15 steps; with exploration it is about 17, two more."""
    assert best_return(windy, WINDY_SIZE, WINDY_START, WINDY_GOAL, 0.0) == -15
    assert best_return(windy, WINDY_SIZE, WINDY_START, WINDY_GOAL, EPSILON) == pytest.approx(-17.05, abs=0.01)


def test_sarsa_ends_about_170_episodes_in_8000_steps() -> None:
    """The example's figure is of one run, and runs differ by 10 (one standard deviation)."""
    rngs = np.random.default_rng(1).spawn(5)
    episodes = [len(walk_windily(windy_learner(0.5), rng, 8000)) for rng in rngs]
    assert 145 < np.mean(episodes) < 180


def test_sarsa_comes_to_the_shortest_way_and_to_the_best_average() -> None:
    quick, rng = windy_learner(0.5), np.random.default_rng(2)
    walk_windily(quick, rng, 8000)
    careful = windy_learner(0.05)
    careful.restore(quick.save())
    lengths = np.array(walk_windily(careful, rng, 30_000)[-600:])
    assert greedy_return(careful, windy, WINDY_START, WINDY_GOAL) == -15
    best = -best_return(windy, WINDY_SIZE, WINDY_START, WINDY_GOAL, EPSILON)
    assert best - band(lengths) < lengths.mean() < best + band(lengths) + 0.5
    assert lengths.min() >= 15


# Cliff walking

CLIFF_MAKERS: dict[str, Callable[[float], Learner]] = {
    "sarsa": lambda alpha: Sarsa(size=CLIFF_SIZE, actions=4, alpha=alpha, gamma=1.0, lambda_=0.0),
    "expected": lambda alpha: ExpectedSarsa(
        size=CLIFF_SIZE, actions=4, alpha=alpha, gamma=1.0, policy=EpsilonGreedy(epsilon=EPSILON)
    ),
    "q": lambda alpha: QLearning(size=CLIFF_SIZE, actions=4, alpha=alpha, gamma=1.0),
}


@cache
def cliff_runs(name: str, alpha: float, episodes: int, runs: int = 4) -> tuple[NDArray[np.float64], list[Learner]]:
    """Return the returns, shape (runs, episodes), and the learners as they ended."""
    learners = [CLIFF_MAKERS[name](alpha) for _ in range(runs)]
    rngs = np.random.default_rng(3).spawn(runs)
    returns = [
        [learn_episode(learner, cliff, CLIFF_START, CLIFF_GOAL, rng)[0] for _ in range(episodes)]
        for learner, rng in zip(learners, rngs, strict=True)
    ]
    return np.array(returns), learners


@pytest.mark.parametrize("other", ["sarsa", "q"])
@pytest.mark.parametrize("alpha", [0.5, 1.0])
def test_expected_sarsa_has_the_best_first_100_episodes(alpha: float, other: str) -> None:
    expected, compared = (cliff_runs(name, alpha, 100)[0].mean(axis=1) for name in ("expected", other))
    assert expected.mean() - compared.mean() > band(expected) + band(compared)


def test_the_first_100_episodes_return_what_the_figure_shows() -> None:
    """Figure 6.3, to about 5: at α = 1 Expected SARSA is near -45, Q-learning near -80."""
    assert abs(cliff_runs("expected", 1.0, 100)[0].mean() + 45) < 6
    assert abs(cliff_runs("q", 1.0, 100)[0].mean() + 80) < 12


def test_q_learning_learns_the_way_along_the_cliff_and_falls_sarsa_the_safe_one() -> None:
    """Example 6.6: online about -50 against -25; the way along the cliff takes 13 steps, the safe one 17."""
    (q_returns, q_learners), (returns, _) = cliff_runs("q", 0.5, 400), cliff_runs("sarsa", 0.5, 400)
    assert [greedy_return(each, cliff, CLIFF_START, CLIFF_GOAL) for each in q_learners] == [-13.0] * len(q_learners)
    assert best_return(cliff, CLIFF_SIZE, CLIFF_START, CLIFF_GOAL, 0.0) == -13
    q_late, late = q_returns[:, 200:].mean(axis=1), returns[:, 200:].mean(axis=1)
    assert abs(q_late.mean() + 50) < 12
    assert abs(late.mean() + 25) < 6
    assert late.mean() - q_late.mean() > band(late) + band(q_late)


def test_expected_sarsa_with_full_steps_comes_to_the_exact_values_of_its_policy() -> None:
    returns, learners = cliff_runs("expected", 1.0, 400)
    exact = best_values(cliff, CLIFF_SIZE, CLIFF_GOAL, EPSILON)
    best = best_return(cliff, CLIFF_SIZE, CLIFF_START, CLIFF_GOAL, EPSILON)
    late = returns[:, 200:].mean(axis=1)
    assert abs(late.mean() - best) < 0.5 + band(late)
    for learner in learners:
        values = learner.action_values(one_hot(CLIFF_START))
        assert values.max() == pytest.approx(exact[CLIFF_START].max(), abs=0.5)
        assert int(values.argmax()) == int(exact[CLIFF_START].argmax())
