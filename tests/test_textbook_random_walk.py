"""The random walk over 19 states (Sutton and Barto, 2nd edition, example 7.1; figures 12.6 and 12.8).

From the middle, left or right with equal chances; the left end gives -1, the right one +1, nothing is discounted.
What is measured is the error over the 19 states (root mean square), averaged over the first 10 episodes.
`FIGURES` has the lowest points of the published curves, at their α, as they can be read off: to about 0.02.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from helpers import step
from numpy.typing import NDArray

from rtagent.experience import Transition
from rtagent.learning import TD, TrueOnlineTD

pytestmark = pytest.mark.slow

STATES, RUNS, EPISODES = 19, 14, 10
VALUES = np.arange(-9, 10) / 10
Curve = tuple[type[TD] | type[TrueOnlineTD], float]

FIGURES: dict[Curve, tuple[float, float]] = {
    (TD, 0.0): (0.8, 0.35),
    (TD, 0.4): (0.7, 0.28),
    (TD, 0.8): (0.3, 0.27),
    (TD, 0.9): (0.2, 0.29),
    (TD, 0.95): (0.12, 0.34),
    (TrueOnlineTD, 0.0): (0.8, 0.35),
    (TrueOnlineTD, 0.4): (0.75, 0.28),
    (TrueOnlineTD, 0.8): (0.4, 0.26),
    (TrueOnlineTD, 0.9): (0.3, 0.28),
    (TrueOnlineTD, 0.95): (0.18, 0.32),
}
"""By learner and λ: α at the lowest point, and the error there."""


def walk(rng: np.random.Generator) -> list[Transition]:
    state, steps = STATES // 2, []
    while True:
        following = state + (1 if rng.random() < 0.5 else -1)
        over = not 0 <= following < STATES
        reward = float(np.sign(following)) if over else 0.0
        steps.append(step(state, None, reward, 0 if over else following, terminated=over))
        if over:
            return steps
        state = following


@cache
def walks() -> list[list[list[Transition]]]:
    rngs = np.random.default_rng(1).spawn(RUNS)
    return [[walk(rng) for _ in range(EPISODES)] for rng in rngs]


@cache
def errors(curve: Curve, alpha: float) -> NDArray[np.float64]:
    """Return the mean error of each run; all curves and step sizes meet the same walks."""
    make, lambda_ = curve
    return np.array(
        [mean_error(make(size=STATES, alpha=alpha, gamma=1.0, lambda_=lambda_), run) for run in walks()]
    )


def mean_error(learner: TD | TrueOnlineTD, episodes: list[list[Transition]]) -> float:
    found = []
    for episode in episodes:
        for transition in episode:
            learner.update(transition)
        found.append(np.sqrt(np.mean((learner.weights - VALUES) ** 2)))
    return float(np.mean(found))


def boxed_error(curve: Curve, alpha: float, episodes: list[list[Transition]]) -> float:
    """Return what the pseudocode of sections 12.2 and 12.5 gives, with dense vectors."""
    make, lambda_ = curve
    w, found = np.zeros(STATES), []
    for episode in episodes:
        z, old = np.zeros(STATES), 0.0
        for t in episode:
            x = np.eye(STATES)[t.features.indices[0]]
            following = np.zeros(STATES) if t.terminated else np.eye(STATES)[t.next_features.indices[0]]
            value, next_value = w @ x, w @ following
            delta = t.reward + next_value - value
            if make is TD:
                z = lambda_ * z + x
                w = w + alpha * delta * z
            else:
                z = lambda_ * z + (1 - alpha * lambda_ * (z @ x)) * x
                w = w + alpha * (delta + value - old) * z - alpha * (value - old) * x
            old = next_value
        found.append(np.sqrt(np.mean((w - VALUES) ** 2)))
    return float(np.mean(found))


def band(found: NDArray[np.float64]) -> float:
    """Return three standard errors of the mean."""
    return float(3 * found.std(ddof=1) / np.sqrt(len(found)))


def is_lower(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Say whether `one` is below `other`, beyond what the same walks could do by chance."""
    return bool((other - one).mean() > band(other - one))


def test_the_walk_is_that_of_the_book() -> None:
    lengths = [len(episode) for run in walks() for episode in run]
    # from the middle of a walk with 10 steps to either end it takes 10 * 10 steps on average
    assert abs(np.mean(lengths) - 100) < band(np.array(lengths))
    # where nothing was learned, the error is the root of 2 (0.1² + … + 0.9²) / 19 = 0.3: the 0.55 of the figures
    assert np.sqrt(np.mean(VALUES**2)) == pytest.approx(np.sqrt(0.3))


@pytest.mark.parametrize("curve", FIGURES, ids=lambda curve: f"{curve[0].__name__}-{curve[1]}")
def test_the_lowest_points_are_where_and_as_low_as_in_the_figures(curve: Curve) -> None:
    alpha, height = FIGURES[curve]
    found = errors(curve, alpha)
    assert abs(found.mean() - height) < 0.02 + band(found)
    assert is_lower(found, errors(curve, alpha / 3))
    assert is_lower(found, errors(curve, min(2.5 * alpha, 1.0)))


@pytest.mark.parametrize("make", [TD, TrueOnlineTD])
def test_a_lambda_in_between_is_best(make: type[TD] | type[TrueOnlineTD]) -> None:
    at_their_best = {
        lambda_: errors((kind, lambda_), alpha) for (kind, lambda_), (alpha, _) in FIGURES.items() if kind is make
    }
    at_their_best[1.0] = errors((make, 1.0), 0.015)
    best = min(at_their_best, key=lambda lambda_: at_their_best[lambda_].mean())
    assert best == 0.8
    for end in (0.0, 0.95, 1.0):
        assert is_lower(at_their_best[0.8], at_their_best[end])
    assert at_their_best[1.0].mean() > 0.45, "without bootstrapping ten episodes teach next to nothing"


@pytest.mark.parametrize(("lambda_", "alpha"), [(0.4, 1.0), (0.8, 0.6), (0.8, 0.75), (0.9, 0.4), (0.95, 0.24)])
def test_true_online_td_bears_larger_steps(lambda_: float, alpha: float) -> None:
    true_online, classical = errors((TrueOnlineTD, lambda_), alpha), errors((TD, lambda_), alpha)
    assert is_lower(true_online, classical)
    assert true_online.mean() < 0.4, "figure 12.8 has no curve above this at these steps"


def test_at_large_steps_td_diverges_and_true_online_td_does_not() -> None:
    assert errors((TD, 0.9), 0.8).mean() > 1.0
    assert errors((TrueOnlineTD, 0.9), 0.8).mean() < 0.45


def test_without_traces_the_two_are_one() -> None:
    for alpha in (0.4, 0.8):
        assert errors((TD, 0.0), alpha) == pytest.approx(errors((TrueOnlineTD, 0.0), alpha), rel=1e-9)


@pytest.mark.parametrize("curve", [(TD, 0.8), (TrueOnlineTD, 0.8)], ids=["td", "true online td"])
def test_the_errors_are_those_of_the_pseudocode_on_the_same_walks(curve: Curve) -> None:
    alpha, _ = FIGURES[curve]
    expected = [boxed_error(curve, alpha, run) for run in walks()[:2]]
    assert errors(curve, alpha)[:2].tolist() == pytest.approx(expected, rel=1e-9)
