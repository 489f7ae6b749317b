"""GTD(λ) against a step computed by hand, its fixed point by linear algebra, and Baird's counterexample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import one_hot, step
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, Transition
from rtagent.learning import GTD, TD


def moving(
    before: FeatureVector, action: int, probability: float, reward: float, after: FeatureVector
) -> Transition:
    return Transition(before, action, probability, reward, after, None, 0, False, False)


def test_two_steps_by_hand() -> None:
    learner = GTD(size=2, target=(0.75, 0.25), alpha=0.5, beta=0.5, gamma=0.8, lambda_=0.5)
    # rho = 0.75 / 0.5 = 1.5; delta 1; e = 1.5 (1, 0); h was 0, so nothing is corrected
    # theta = 0.5 * 1 * (1.5, 0) = (0.75, 0); h = the same; then e decays by 0.4 to (0.6, 0)
    assert learner.update(moving(one_hot(0), 0, 0.5, 1.0, one_hot(1))) == pytest.approx(1.0)
    assert learner.weights.tolist() == [0.75, 0.0]
    assert learner.h.tolist() == [0.75, 0.0]
    # rho = 0.25 / 0.5 = 0.5; delta 2 + 0.8 * 0.75 - 0 = 2.6; e = 0.5 (0.6, 1) = (0.3, 0.5); e'h = 0.225
    # theta = (0.75, 0) + 0.5 (2.6 (0.3, 0.5) - 0.8 * 0.5 * 0.225 (1, 0)) = (0.75 + 0.39 - 0.045, 0.65)
    # h = (0.75, 0) + 0.5 (2.6 (0.3, 0.5) - 0 * (0, 1)) = (1.14, 0.65)
    assert learner.update(moving(one_hot(1), 1, 0.5, 2.0, one_hot(0))) == pytest.approx(2.6)
    assert learner.weights == pytest.approx(np.array([1.095, 0.65]))
    assert learner.h == pytest.approx(np.array([1.14, 0.65]))
    # rho = 1.5; delta 1 - 1.095 at the end; e = 1.5 (0.12 + 1, 0.2) = (1.68, 0.3); then it is reset
    # h = (1.14, 0.65) + 0.5 (-0.095 (1.68, 0.3) - 1.14 (1, 0))
    assert learner.update(step(0, 0, 1.0, 1, terminated=True)) == pytest.approx(-0.095)
    assert learner.weights == pytest.approx(np.array([1.095, 0.65]) - 0.5 * 0.095 * 0.75 * np.array([1.12, 0.2]))
    assert not learner.trace.any()


@given(st.integers(0, 10**6), st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=30)
def test_on_policy_and_without_its_second_weights_it_is_td(seed: int, gamma: float, lambda_: float) -> None:
    rng = np.random.default_rng(seed)
    td = TD(size=6, alpha=0.1, gamma=gamma, lambda_=lambda_)
    gtd = GTD(size=6, target=lambda t: t.probability, alpha=0.1, beta=1e-300, gamma=gamma, lambda_=lambda_)
    for _ in range(30):
        transition = moving(one_hot(int(rng.integers(6))), 0, 0.3, rng.normal(), one_hot(int(rng.integers(6))))
        transition.truncated = bool(rng.random() < 0.1)
        assert gtd.update(transition) == pytest.approx(td.update(transition))
    np.testing.assert_allclose(gtd.weights, td.weights, rtol=1e-9, atol=1e-12)


# A small process with two actions, four states and two features

FEATURES = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0], [0.3, -0.7]])
CHANCES = np.array(
    [
        [[0.1, 0.6, 0.2, 0.1], [0.3, 0.3, 0.3, 0.1], [0.2, 0.2, 0.2, 0.4], [0.7, 0.1, 0.1, 0.1]],
        [[0.5, 0.1, 0.1, 0.3], [0.1, 0.1, 0.7, 0.1], [0.4, 0.4, 0.1, 0.1], [0.1, 0.2, 0.6, 0.1]],
    ]
)
REWARDS = np.array([[1.0, 0.0, -1.0, 2.0], [0.0, 2.0, 1.0, -1.0]])
BEHAVIOUR, TARGET = np.array([0.5, 0.5]), np.array([0.9, 0.1])
GAMMA = 0.8


def fixed_point(lambda_: float) -> np.ndarray:
    """Return the weights at which off-policy TD(λ) would rest: states are weighted as the behaviour visits them."""
    visits = np.linalg.matrix_power(np.tensordot(BEHAVIOUR, CHANCES, 1), 200)[0]
    moves, rewards = np.tensordot(TARGET, CHANCES, 1), TARGET @ REWARDS
    weighted = FEATURES.T @ np.diag(visits) @ np.linalg.inv(np.eye(4) - GAMMA * lambda_ * moves)
    a = weighted @ (np.eye(4) - GAMMA * moves) @ FEATURES
    solution: np.ndarray = np.linalg.solve(a, weighted @ rewards)
    return solution


@pytest.mark.parametrize("lambda_", [0.0, 0.6])
@pytest.mark.slow
def test_it_finds_the_fixed_point_of_the_target_policy(lambda_: float) -> None:
    rng = np.random.default_rng(1)
    learner = GTD(size=2, target=tuple(TARGET), alpha=0.02, beta=0.02, gamma=GAMMA, lambda_=lambda_)
    vectors = [FeatureVector(np.arange(2), row) for row in FEATURES]
    steps, state, average = 40_000, 0, np.zeros(2)
    actions, draws = rng.integers(2, size=steps).tolist(), rng.random(steps)
    ends = CHANCES.cumsum(axis=2)
    for time, (action, draw) in enumerate(zip(actions, draws, strict=True)):
        following = min(int(np.searchsorted(ends[action, state], draw)), 3)
        learner.update(moving(vectors[state], action, 0.5, REWARDS[action, state], vectors[following]))
        state = following
        average += learner.theta * (time >= steps // 2)
    assert average / (steps // 2) == pytest.approx(fixed_point(lambda_), abs=0.12)
    on_policy = np.linalg.norm(fixed_point(lambda_) - behaviour_point(lambda_))
    assert on_policy > 0.5  # the fixed point of the behaviour lies elsewhere


def behaviour_point(lambda_: float) -> np.ndarray:
    visits = np.linalg.matrix_power(np.tensordot(BEHAVIOUR, CHANCES, 1), 200)[0]
    moves, rewards = np.tensordot(BEHAVIOUR, CHANCES, 1), BEHAVIOUR @ REWARDS
    weighted = FEATURES.T @ np.diag(visits) @ np.linalg.inv(np.eye(4) - GAMMA * lambda_ * moves)
    solution: np.ndarray = np.linalg.solve(weighted @ (np.eye(4) - GAMMA * moves) @ FEATURES, weighted @ rewards)
    return solution


def baird(state: int) -> FeatureVector:
    """Return the features of Baird's counterexample (Sutton and Barto, figure 11.1); state 6 is the lower one."""
    return FeatureVector(np.array([state, 7]), np.array([1.0, 2.0] if state == 6 else [2.0, 1.0]))


def bairds_steps(learner: Any, steps: int, seed: int) -> list[float]:
    """Behave: to an upper state with 6/7, to the lower one with 1/7; return how large the weights were."""
    rng, state, sizes = np.random.default_rng(seed), 0, []
    for _ in range(steps):
        solid = bool(rng.random() < 1 / 7)
        following = 6 if solid else int(rng.integers(6))
        learner.update(moving(baird(state), int(solid), 1 / 7 if solid else 6 / 7, 0.0, baird(following)))
        state = following
        sizes.append(float(np.abs(learner.weights).max()))
    return sizes


class OffPolicyTD:
    """Semi-gradient off-policy TD(0) (Sutton and Barto, equation 11.2), for what it does here."""

    def __init__(self, weights: np.ndarray) -> None:
        self.weights = weights

    def update(self, t: Transition) -> None:
        x, y = np.zeros(8), np.zeros(8)
        x[t.features.indices], y[t.next_features.indices] = t.features.values, t.next_features.values
        delta = 0.99 * self.weights @ y - self.weights @ x
        self.weights = self.weights + 0.01 * float(t.action or 0) / t.probability * delta * x


def test_it_stays_where_off_policy_td_diverges() -> None:
    start = np.array([1.0, 1, 1, 1, 1, 1, 10, 1])
    diverging = bairds_steps(OffPolicyTD(start.copy()), 1500, seed=4)
    assert diverging[-1] > 100
    learner = GTD(size=8, target=(0.0, 1.0), alpha=0.005, beta=0.05, gamma=0.99, lambda_=0.0)
    learner.restore(learner.save() | {"theta": start})
    sizes = bairds_steps(learner, 20_000, seed=4)
    assert max(sizes) < 20
    # figure 11.5: the error in the Bellman equation of the target policy, always to the lower state, vanishes
    errors = [0.99 * learner.predict(baird(6)) - learner.predict(baird(state)) for state in range(7)]
    assert np.abs(errors).max() < 0.5


# Bad input


@pytest.mark.parametrize("probability", [0.0, -0.1, 1.5, float("nan")])
def test_a_behaviour_that_does_not_know_its_probability_is_told(probability: float) -> None:
    learner = GTD(size=2, target=(0.5, 0.5))
    with pytest.raises(SpecError, match=r"action 1 with probability .*above 0 and at most 1"):
        learner.update(moving(one_hot(0), 1, probability, 1.0, one_hot(1)))
    assert not learner.weights.any()
    assert not learner.trace.any()


def test_a_transition_without_an_action_is_told() -> None:
    with pytest.raises(SpecError, match="needs the actions"):
        GTD(size=2, target=(0.5, 0.5)).update(step(0, None, 1.0, 1))


@pytest.mark.parametrize("target", [(), (0.5, 0.6), (-0.5, 1.5), (float("nan"), 1.0)])
def test_a_target_that_is_no_policy_is_told(target: tuple[float, ...]) -> None:
    with pytest.raises(SpecError, match="target is"):
        GTD(size=2, target=target)


def test_a_target_that_does_not_know_an_action_is_told() -> None:
    with pytest.raises(SpecError, match="no action 2"):
        GTD(size=2, target=(0.5, 0.5)).update(moving(one_hot(0), 2, 0.3, 1.0, one_hot(1)))
    with pytest.raises(SpecError, match=r"probability 1\.5"):
        GTD(size=2, target=lambda t: 1.5).update(moving(one_hot(0), 0, 0.3, 1.0, one_hot(1)))


@pytest.mark.parametrize("ends", ["terminated", "truncated", "not"])
def test_what_is_not_finite_never_reaches_a_weight(ends: str) -> None:
    learner = GTD(size=2, target=(1.0,), beta=0.1)
    learner.update(step(0, 0, 1.0, 1))
    before = {name: array.tolist() for name, array in learner.save().items()}
    for reward, value in ((float("nan"), 1.0), (float("inf"), 1.0), (1.0, float("nan")), (1.0, float("-inf"))):
        features = FeatureVector(np.array([1]), np.array([value]))
        transition = moving(features, 0, 1.0, reward, one_hot(0))
        transition.terminated, transition.truncated = ends == "terminated", ends == "truncated"
        with pytest.raises(SpecError, match="nothing was learned"):
            learner.update(transition)
    assert {name: array.tolist() for name, array in learner.save().items()} == before


def test_what_is_restored_goes_on_exactly() -> None:
    rng = np.random.default_rng(5)
    learner, fresh = (GTD(size=6, target=(0.3, 0.7), beta=0.05) for _ in range(2))
    transitions = [
        moving(
            one_hot(int(rng.integers(6))), int(rng.integers(2)), 0.5, rng.normal(), one_hot(int(rng.integers(6)))
        )
        for _ in range(40)
    ]
    for t in transitions[:20]:
        learner.update(t)
    fresh.restore(learner.save())
    assert [learner.update(t) for t in transitions[20:]] == [fresh.update(t) for t in transitions[20:]]
    with pytest.raises(SpecError, match="other settings"):
        learner.restore(GTD(size=7, target=(1.0,)).save())
