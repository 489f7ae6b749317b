"""Policies: what they choose, how often, and what they say about it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator
from scipy import stats

from rtagent.errors import SpecError
from rtagent.policy import EpsilonGreedy, Greedy, Policy

VALUES = st.lists(st.sampled_from([-1.0, 0.0, 0.5, 2.0]), min_size=1, max_size=5)


class Forbidden(Generator):
    """A generator from which nothing may be drawn."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def random(self, *args: object, **settings: object) -> None:
        raise AssertionError("something was drawn")

    integers = random


@given(VALUES, st.floats(0, 1))
@settings(max_examples=200)
def test_probabilities_are_those_of_the_definition(values: list[float], epsilon: float) -> None:
    best = [value == max(values) for value in values]
    expected = [(1 - epsilon) * is_best / sum(best) + epsilon / len(values) for is_best in best]
    probabilities = EpsilonGreedy(epsilon=epsilon).probabilities(np.array(values))
    assert probabilities == pytest.approx(np.array(expected))
    assert probabilities.sum() == pytest.approx(1.0)


@given(VALUES, st.sampled_from([0.0, 0.1, 1.0]), st.integers(0, 2**32))
@settings(max_examples=200)
def test_a_choice_is_reported_with_its_own_probability(values: list[float], epsilon: float, seed: int) -> None:
    policies: tuple[Policy, ...] = (Greedy(), EpsilonGreedy(epsilon=epsilon))
    for policy in policies:
        action, probability = policy.choose(np.array(values), np.random.default_rng(seed))
        assert type(action) is int
        assert probability == policy.probabilities(np.array(values))[action] > 0


@pytest.mark.parametrize(
    "policy", [Greedy(), EpsilonGreedy(epsilon=0.0), EpsilonGreedy(epsilon=0.3), EpsilonGreedy(epsilon=1.0)]
)
@pytest.mark.parametrize("values", [[0.0, 1.0, 1.0, -1.0], [0.0, 0.0, 0.0, 0.0], [3.0, 1.0, 2.0, 0.0]])
def test_actions_are_chosen_as_often_as_their_probabilities_say(policy: Policy, values: list[float]) -> None:
    rng, draws = np.random.default_rng(1), 4000
    counts = np.bincount([policy.choose(np.array(values), rng)[0] for _ in range(draws)], minlength=4)
    expected = policy.probabilities(np.array(values)) * draws
    possible = expected > 0
    assert counts[~possible].sum() == 0
    assert possible.sum() == 1 or stats.chisquare(counts[possible], expected[possible]).pvalue > 1e-4


@pytest.mark.parametrize("policy", [Greedy(), EpsilonGreedy(epsilon=0.0)])
def test_nothing_is_drawn_where_there_is_nothing_to_choose(policy: Policy) -> None:
    assert policy.choose(np.array([0.0, 2.0, 1.0]), Forbidden()) == (1, 1.0)


def test_choosing_changes_no_value() -> None:
    values = np.array([0.0, 1.0, 1.0])
    EpsilonGreedy(epsilon=0.5).choose(values, np.random.default_rng(0))
    Greedy().probabilities(values)
    assert values.tolist() == [0.0, 1.0, 1.0]


@pytest.mark.parametrize("epsilon", [-0.1, 1.1, float("nan")])
def test_an_epsilon_that_is_no_probability_is_refused(epsilon: float) -> None:
    with pytest.raises(SpecError, match="epsilon"):
        EpsilonGreedy(epsilon=epsilon)
