"""True online learners: equal to the online λ-return computed from its definition, and to hand-computed steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.experience import FeatureVector, Transition
from rtagent.learning import TD, Sarsa, TrueOnlineSarsa, TrueOnlineTD

SIZE = 5


def vector(values: np.ndarray) -> FeatureVector:
    indices = np.flatnonzero(values)
    return FeatureVector(indices, values[indices])


def step(
    x: np.ndarray, reward: float, y: np.ndarray, *, action: int | None = None, next_action: int | None = None,
    terminated: bool = False, truncated: bool = False,
) -> Transition:  # fmt: skip
    return Transition(vector(x), action, 1.0, reward, vector(y), next_action, 0, terminated, truncated)


def online_lambda_return(
    xs: np.ndarray, rewards: np.ndarray, alpha: float, gamma: float, lambda_: float, terminated: bool
) -> list[np.ndarray]:
    """Return the weights after each step, from the definition (Sutton and Barto, section 12.3).

    `known[t]` are the weights that were known at time t; at each horizon h all updates are made anew.
    """
    known = [np.zeros(xs.shape[1])]
    for h in range(1, len(rewards) + 1):
        weights = np.zeros(xs.shape[1])
        for k in range(h):
            target = truncated_lambda_return(xs, rewards, known, k, h, gamma, lambda_, terminated)
            weights = weights + alpha * (target - weights @ xs[k]) * xs[k]
        known.append(weights)
    return known


def truncated_lambda_return(
    xs: np.ndarray, rewards: np.ndarray, known: list[np.ndarray], k: int, h: int, gamma: float, lambda_: float,
    terminated: bool,
) -> float:  # fmt: skip
    def n_step(n: int) -> float:
        end = k + n
        value = 0.0 if terminated and end == len(rewards) else float(known[end - 1] @ xs[end])
        return sum(gamma**i * rewards[k + i] for i in range(n)) + gamma**n * value

    early = (1 - lambda_) * sum(lambda_ ** (n - 1) * n_step(n) for n in range(1, h - k))
    return early + lambda_ ** (h - k - 1) * n_step(h - k)


@settings(max_examples=60)
@given(
    st.integers(0, 10**6), st.integers(1, 9), st.floats(0.01, 0.5), st.floats(0, 1), st.floats(0, 1), st.booleans()
)
def test_true_online_td_is_the_online_lambda_return(
    seed: int, length: int, alpha: float, gamma: float, lambda_: float, terminated: bool
) -> None:
    rng = np.random.default_rng(seed)
    xs = rng.random((length + 1, SIZE)) * (rng.random((length + 1, SIZE)) < 0.7)
    rewards = rng.normal(size=length)
    expected = online_lambda_return(xs, rewards, alpha, gamma, lambda_, terminated)
    learner = TrueOnlineTD(size=SIZE, alpha=alpha, gamma=gamma, lambda_=lambda_)
    for t in range(length):
        last = t == length - 1
        learner.update(step(xs[t], rewards[t], xs[t + 1], terminated=terminated and last))
        np.testing.assert_allclose(learner.weights, expected[t + 1], rtol=1e-9, atol=1e-9)


def general_online_lambda_return(
    xs: np.ndarray, rewards: np.ndarray, alpha: float, gammas: np.ndarray, lambdas: np.ndarray
) -> list[np.ndarray]:
    """Return the weights after each step, γ and λ being those of the state in which each step ends.

    The return of each step is the reward, and γ of the next state times a mixture of its value and its return
    (Sutton and Barto, equation 12.18), as far as the horizon; the online algorithm then as above.
    """
    known = [np.zeros(xs.shape[1])]
    for h in range(1, len(rewards) + 1):
        weights = np.zeros(xs.shape[1])
        for k in range(h):
            target = float(known[h - 1] @ xs[h])
            for t in reversed(range(k, h)):
                bootstrap = float(known[t] @ xs[t + 1]) if t + 1 < h else target
                target = rewards[t] + gammas[t] * ((1 - lambdas[t]) * bootstrap + lambdas[t] * target)
            weights = weights + alpha * (target - weights @ xs[k]) * xs[k]
        known.append(weights)
    return known


fractions = st.sampled_from([0.0, 0.3, 0.9, 1.0])


@settings(max_examples=60)
@given(
    st.integers(0, 10**6),
    st.lists(st.tuples(fractions, fractions), min_size=1, max_size=9),
    st.floats(0.01, 0.5),
    st.booleans(),
)
def test_true_online_td_is_the_online_lambda_return_where_gamma_and_lambda_depend_on_the_state(
    seed: int, rates: list[tuple[float, float]], alpha: float, compiled: bool
) -> None:
    gammas, lambdas = np.array(rates).T
    rng, length = np.random.default_rng(seed), len(rates)
    xs = rng.random((length + 1, SIZE)) * (rng.random((length + 1, SIZE)) < 0.7)
    rewards = rng.normal(size=length)
    expected = general_online_lambda_return(xs, rewards, alpha, gammas, lambdas)
    learner = TrueOnlineTD(
        size=1000 if compiled else SIZE,
        active=SIZE,
        alpha=alpha,
        divide_alpha=False,
        gamma=lambda t: gammas[t.elapsed],
        lambda_=lambda t: lambdas[t.elapsed],
    )
    for t in range(length):
        transition = step(xs[t], rewards[t], xs[t + 1])
        transition.elapsed = t
        learner.update(transition)
        np.testing.assert_allclose(learner.weights[:SIZE], expected[t + 1], rtol=1e-9, atol=1e-9)


def test_two_steps_by_hand() -> None:
    """Two binary features that overlap; alpha 0.5, gamma 0.5, lambda 1, all in fractions of two."""
    learner = TrueOnlineTD(size=2, alpha=0.5, gamma=0.5, lambda_=1.0)
    a, b = np.array([1.0, 0.0]), np.array([1.0, 1.0])
    # estimate 0, next value 0: delta 1; trace 0.5 [1, 0]; weights [0.5, 0]
    assert learner.update(step(a, 1.0, b)) == 1.0
    assert learner.weights.tolist() == [0.5, 0.0]
    # the estimate of b was 0 (before learning), its value is now 0.5; delta 2 - 0
    # trace 0.25 [1, 0] + 0.5 (1 - 0.25) [1, 1] = [0.625, 0.375]
    # weights [0.5, 0] + 2 [0.625, 0.375] + 0.5 (0 - 0.5) [1, 1] = [1.5, 0.5]
    assert learner.update(step(b, 2.0, a, terminated=True)) == 2.0
    assert learner.weights.tolist() == [1.5, 0.5]


def test_after_an_episode_nothing_of_it_is_left_in_the_trace() -> None:
    rng = np.random.default_rng(3)
    xs = rng.random((4, SIZE))
    for ending in ({"terminated": True}, {"truncated": True}):
        first = TrueOnlineTD(size=SIZE)
        first.update(step(xs[0], 1.0, xs[1], **ending))
        again = TrueOnlineTD(size=SIZE)
        again.restore(first.save())
        assert not first.save()["theta"]["trace"].any()
        assert first.update(step(xs[2], 1.0, xs[3])) == again.update(step(xs[2], 1.0, xs[3]))
        assert first.weights.tolist() == again.weights.tolist()


def test_a_truncated_episode_bootstraps_and_a_terminated_one_does_not() -> None:
    x, y = np.eye(SIZE)[0], np.eye(SIZE)[1]
    cut, ended = (TrueOnlineTD(size=SIZE, initial=1.0, gamma=0.9) for _ in range(2))
    assert cut.update(step(x, 0.0, y, truncated=True)) == pytest.approx(0.9 - 1.0)
    assert ended.update(step(x, 0.0, y, terminated=True)) == pytest.approx(-1.0)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.floats(0.01, 0.5), st.floats(0, 1))
def test_with_lambda_0_and_one_hot_features_they_are_the_classical_ones(
    seed: int, alpha: float, gamma: float
) -> None:
    rng = np.random.default_rng(seed)
    steps = {"alpha": alpha, "gamma": gamma, "lambda_": 0.0}
    td, true_td = TD(size=SIZE, **steps), TrueOnlineTD(size=SIZE, **steps)
    sarsa, true_sarsa = Sarsa(size=SIZE, actions=2, **steps), TrueOnlineSarsa(size=SIZE, actions=2, **steps)
    states, actions = rng.permutation(SIZE), rng.integers(0, 2, SIZE)
    for t in range(SIZE - 1):
        x, y = np.eye(SIZE)[states[t]], np.eye(SIZE)[states[t + 1]]
        transition = step(x, float(rng.normal()), y, action=int(actions[t]), next_action=int(actions[t + 1]))
        assert td.update(transition) == pytest.approx(true_td.update(transition))
        assert sarsa.update(transition) == pytest.approx(true_sarsa.update(transition))
    np.testing.assert_allclose(td.weights, true_td.weights)
    np.testing.assert_allclose(sarsa.weights, true_sarsa.weights)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.floats(0, 1), st.floats(0, 1))
def test_true_online_sarsa_is_true_online_td_on_pairs_of_state_and_action(
    seed: int, gamma: float, lambda_: float
) -> None:
    rng = np.random.default_rng(seed)
    sarsa = TrueOnlineSarsa(size=SIZE, actions=3, alpha=0.1, gamma=gamma, lambda_=lambda_)
    pairs = TrueOnlineTD(size=3 * SIZE, alpha=0.1, gamma=gamma, lambda_=lambda_)
    xs, actions = rng.random((12, SIZE)), rng.integers(0, 3, 12)
    wide = np.zeros((12, 3, SIZE))
    wide[np.arange(12), actions] = xs
    for t in range(11):
        reward, end = float(rng.normal()), t == 10
        sarsa.update(
            step(xs[t], reward, xs[t + 1], action=int(actions[t]), next_action=int(actions[t + 1]), terminated=end)
        )
        pairs.update(step(wide[t].ravel(), reward, wide[t + 1].ravel(), terminated=end))
    np.testing.assert_allclose(sarsa.weights.ravel(), pairs.weights, rtol=1e-9, atol=1e-12)
