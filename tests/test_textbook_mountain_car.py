"""Mountain car with SARSA(λ) and tile coding (Sutton and Barto, 2nd edition, example 10.1 and figure 12.10).

8 tilings of 8 × 8 with asymmetric offsets, replacing traces, no discount, greedy over optimistic weights of 0.
What is measured are the steps of an episode, averaged over the first 50. The published curves, whose axis goes from
180 to 300 steps over α times the 8 tilings: λ = 0 comes down to about 230 where α is large; λ from 0.9 to 0.96 has
its best near 1, at about 180.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial

import numpy as np
import pytest
from numpy.typing import NDArray

from rtagent import Spec
from rtagent.experience import Transition
from rtagent.features import TileCoding, Tilings
from rtagent.learning import Sarsa, TrueOnlineSarsa
from rtagent.policy import Greedy

pytestmark = pytest.mark.slow

STATE = {"position": Spec(low=-1.2, high=0.5), "velocity": Spec(low=-0.07, high=0.07)}
RUNS, EPISODES = 4, 50
TOO_LONG = 10_000
Learner = Sarsa | TrueOnlineSarsa
MARGIN = 15
"""More steps than the means of so few runs differ by chance: their standard errors are from 2 to 5."""


def drive(position: float, velocity: float, throttle: int) -> tuple[float, float]:
    """Return the next position and velocity; the throttle is -1, 0 or 1 (equations of example 10.1)."""
    velocity = min(max(velocity + 0.001 * throttle - 0.0025 * math.cos(3 * position), -0.07), 0.07)
    position = position + velocity
    return (-1.2, 0.0) if position < -1.2 else (min(position, 0.5), velocity)


def episode(coder: TileCoding, learner: Learner, rng: np.random.Generator) -> int:
    """Learn one episode and return its steps."""
    policy, state = Greedy(), (float(rng.uniform(-0.6, -0.4)), 0.0)
    features = coder.encode(state)
    action, _ = policy.choose(learner.action_values(features), rng)
    for steps in range(1, TOO_LONG):
        state = drive(*state, action - 1)
        arrived = state[0] >= 0.5
        following = coder.encode(state)
        next_action, _ = policy.choose(learner.action_values(following), rng)
        learner.update(Transition(features, action, 1.0, -1.0, following, next_action, 0, arrived, False))
        if arrived:
            return steps
        features, action = following, next_action
    pytest.fail(f"not at the goal after {TOO_LONG} steps")


@cache
def steps(lambda_: float, alpha_times_tilings: float, *, true_online: bool = False) -> NDArray[np.float64]:
    """Return the steps of the episodes, shape (runs, episodes)."""
    make = TrueOnlineSarsa if true_online else partial(Sarsa, trace="replacing")
    settings = {"alpha": alpha_times_tilings, "gamma": 1.0, "lambda_": lambda_}
    return np.array([run(partial(make, **settings), seed) for seed in range(RUNS)])


def run(make: Callable[..., Learner], seed: int) -> list[int]:
    coder = TileCoding(state=STATE, layers=(Tilings(8, 8),))
    learner, rng = make(size=coder.size, active=coder.active, actions=3), np.random.default_rng(seed)
    return [episode(coder, learner, rng) for _ in range(EPISODES)]


def test_the_engine_is_too_weak_to_go_straight_up() -> None:
    state = (-0.5, 0.0)
    for _ in range(500):
        state = drive(*state, 1)
        assert state[0] < 0.0


@pytest.mark.parametrize(
    ("lambda_", "alpha_times_tilings", "low", "high"),
    [
        (0.0, 0.5, 265, 300),
        (0.0, 1.5, 215, 245),
        (0.92, 0.25, 235, 285),
        (0.92, 1.0, 170, 205),
        (0.96, 1.0, 165, 200),
    ],
)
def test_the_steps_are_as_many_as_in_the_figure(
    lambda_: float, alpha_times_tilings: float, low: float, high: float
) -> None:
    assert low < steps(lambda_, alpha_times_tilings).mean() < high


@pytest.mark.parametrize("lambda_", [0.92, 0.96])
def test_long_traces_learn_quicker_than_none_at_their_best(lambda_: float) -> None:
    assert steps(lambda_, 1.0).mean() < steps(0.0, 1.5).mean() - MARGIN


def test_small_steps_learn_slowly() -> None:
    assert steps(0.92, 1.0).mean() < steps(0.92, 0.25).mean() - MARGIN


def test_true_online_sarsa_makes_more_of_small_steps() -> None:
    """As in figure 12.11, where it is better than replacing traces."""
    assert steps(0.92, 0.25, true_online=True).mean() < steps(0.92, 0.25).mean() - MARGIN


def test_it_goes_on_learning_within_the_50_episodes() -> None:
    found = steps(0.92, 1.0)
    assert found[:, 0].mean() > 500, "the first episode explores"
    assert found[:, -10:].mean() < 150
