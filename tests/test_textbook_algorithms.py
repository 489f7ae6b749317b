"""Steps of the thesis's Algorithms 2 to 5 and of sparse distributed memory, computed by hand.

Algorithm 1 by hand, and against its definition: test_true_online.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers import learn, one_hot
from scipy import integrate, stats

from rtagent import Agent, Outcome, Spec
from rtagent.experience import FeatureVector, FloatArray, State
from rtagent.features import KanervaCoding, SelectiveKanerva, SparseMemory
from rtagent.learning import Sarsa

# Algorithms 2 and 3


class Table:
    """One feature for each of three states."""

    size, active = 3, 1

    def encode(self, state: State) -> FeatureVector:
        return one_hot(int(state[0]))


class Told:
    """A policy that takes the actions it was told, and keeps what it was shown."""

    def __init__(self, *actions: int) -> None:
        self._actions = list(actions)
        self.shown: list[list[float]] = []

    def choose(self, action_values: FloatArray, rng: np.random.Generator) -> tuple[int, float]:
        self.shown.append(action_values.tolist())
        return self._actions.pop(0), 1.0

    def probabilities(self, action_values: FloatArray) -> FloatArray:
        return np.full(len(action_values), 1 / len(action_values))


EXPERIENCE = [Outcome((1,), 4.0), Outcome((0,), 2.0), Outcome((2,), -1.0, terminated=True)]
"""What is observed after the first, the second and the third action; it begins in state 0."""


def agent_of_the_algorithms() -> tuple[Agent, Sarsa, Told]:
    learner, policy = Sarsa(size=3, actions=2, alpha=0.5, gamma=0.5, lambda_=0.0), Told(0, 1, 0)
    return Agent(Table(), learner, policy), learner, policy


def after_three_steps() -> FloatArray:
    # Q(0, 0) = 0.5 (4 + 0.5 Q(1, 1) - 0) = 2
    # Q(1, 1) = 0.5 (2 + 0.5 Q(0, 0) - 0) = 0.5 (2 + 1) = 1.5
    # Q(0, 0) = 2 + 0.5 (-1 - 2) = 0.5, the terminal state being worth nothing
    return np.array([[0.5, 0.0, 0.0], [0.0, 1.5, 0.0]])


def test_sarsa_as_in_algorithm_2() -> None:
    agent, learner, policy = agent_of_the_algorithms()
    agent.observe(Outcome((0,)), 0)
    agent.choose()
    deltas = []
    for time, outcome in enumerate(EXPERIENCE, 1):
        agent.acted()  # take action A
        agent.observe(outcome, time)
        if not outcome.terminated:
            agent.choose()
        deltas.append(learn(agent)[1])
    assert deltas == [4.0, 3.0, -3.0]
    assert learner.weights.tolist() == after_three_steps().tolist()
    assert policy.shown == [[0.0, 0.0], [0.0, 0.0], [2.0, 0.0]], "it learns before it goes on"


def test_reactive_sarsa_as_in_algorithm_3() -> None:
    agent, learner, policy = agent_of_the_algorithms()
    agent.observe(Outcome((0,)), 0)
    agent.choose()
    agent.acted()  # take action A
    deltas = []
    for time, outcome in enumerate(EXPERIENCE, 1):
        agent.observe(outcome, time)
        if not outcome.terminated:
            agent.choose()
            agent.acted()  # take action A', and only then learn
        deltas.append(learn(agent)[1])
    assert deltas == [4.0, 3.0, -3.0]
    assert learner.weights.tolist() == after_three_steps().tolist()
    assert policy.shown == [[0.0, 0.0], [0.0, 0.0], [2.0, 0.0]]


# Algorithms 4 and 5: the corners of a square, and a point within it

UNIT = Spec(low=0.0, high=1.0)
SQUARE = {"x": UNIT, "y": UNIT}
PROTOTYPES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.75, 0.5]])
POINT = (0.375, 0.5)
# from the point to the prototypes: (3/8, 4/8), (5/8, 4/8), (3/8, 4/8), (5/8, 4/8), (3/8, 0)
# euclidean: 0.625, 0.8004, 0.625, 0.8004, 0.375; city block: 0.875, 1.125, 0.875, 1.125, 0.375
# max: 0.5, 0.625, 0.5, 0.625, 0.375


@pytest.mark.parametrize(
    ("distance", "radius", "active"),
    [
        ("euclidean", 0.626, [0, 2, 4]),
        ("euclidean", 0.625, [4]),  # d < r, and not d = r
        ("euclidean", 0.376, [4]),
        ("euclidean", 0.375, []),
        ("euclidean", 0.81, [0, 1, 2, 3, 4]),
        ("city_block", 0.876, [0, 2, 4]),
        ("city_block", 0.875, [4]),
        ("max", 0.501, [0, 2, 4]),
        ("max", 0.5, [4]),
    ],
)
def test_kanerva_coding_as_in_algorithm_4(distance: str, radius: float, active: list[int]) -> None:
    coder = KanervaCoding(state=SQUARE, prototypes=PROTOTYPES, radius=radius, distance=distance)  # type: ignore[arg-type]
    features = coder.encode(POINT)
    assert sorted(features.indices.tolist()) == active
    assert features.values is None


@pytest.mark.parametrize("distance", ["euclidean", "city_block", "max"])
@pytest.mark.parametrize(
    ("eta", "active"),
    [
        (0.2, [4]),
        (0.39, [4]),  # c is the floor of 5 · 0.39 = 1.95
        (0.4, [0, 4]),  # a tie of the prototypes 0 and 2: the lower number
        (0.6, [0, 2, 4]),
        (0.8, [0, 1, 2, 4]),
    ],
)
def test_selective_kanerva_coding_as_in_algorithm_5(distance: str, eta: float, active: list[int]) -> None:
    coder = SelectiveKanerva(state=SQUARE, prototypes=PROTOTYPES, eta=eta, distance=distance)  # type: ignore[arg-type]
    features = coder.encode(POINT)
    assert sorted(features.indices.tolist()) == active
    assert coder.active == len(active)


def test_real_valued_features_by_hand() -> None:
    """On a line: prototypes at 0.125, 0.25 and, the nearest left out, 0.5 from the state."""
    coder = SelectiveKanerva(
        state={"x": UNIT},
        prototypes=np.array([[0.125], [0.25], [0.5], [1.0]]),
        eta=0.5,
        proximity=True,
    )
    features = coder.encode((0.0,))
    assert features.values is not None
    # 1 - 0.125 / 0.5 = 0.75 and 1 - 0.25 / 0.5 = 0.5; scaled by 2 / 1.25 so that they sum to c = 2
    found = dict(zip(features.indices.tolist(), features.values.tolist(), strict=True))
    assert found == pytest.approx({0: 1.2, 1: 0.8})


@pytest.mark.parametrize("signals", [1, 2, 4, 8])
@pytest.mark.parametrize("count", [10, 100, 1000])
def test_the_nearest_prototype_is_as_far_as_is_to_be_expected(signals: int, count: int) -> None:
    """Thesis, figure 6.2; by the largest difference, so that what is to be expected can be integrated."""
    points, state = np.random.default_rng(5).random((20, signals)), {str(n): UNIT for n in range(signals)}
    found = []
    for seed in range(20):
        coder = SelectiveKanerva(state=state, prototypes=count, eta=1 / count, distance="max", seed=seed)
        nearest = [coder.prototypes[coder.encode(point).indices[0]] for point in points]
        found.append(np.abs(np.array(nearest) - points).max(axis=1).mean())
    expected = np.mean([expected_distance(point, count) for point in points])
    assert abs(np.mean(found) - expected) < 4 * np.std(found, ddof=1) / np.sqrt(len(found))


def expected_distance(point: FloatArray, count: int) -> float:
    """Return the mean distance of `point` to the nearest of `count` uniform ones: ∫ (1 - share in r)^count dr."""
    r = np.linspace(0, 1, 2001)[:, None]
    share = (np.minimum(point + r, 1) - np.maximum(point - r, 0)).prod(axis=1)
    return float(integrate.trapezoid((1 - share) ** count, r[:, 0]))


# Sparse distributed memory


def test_a_sparse_memory_by_hand() -> None:
    memory = SparseMemory([[0, 0, 0, 0, 0], [1, 1, 0, 0, 0], [1, 1, 1, 1, 1]], radius=3)
    # 10000 is 1, 1 and 4 bits from the prototypes; 11100 is 3, 1 and 2 bits: below 3, and not 3, is activated
    assert memory.activated([1, 0, 0, 0, 0]).tolist() == [0, 1]
    assert memory.activated([1, 1, 1, 0, 0]).tolist() == [1, 2]
    memory.write([1, 0, 0, 0, 0], 6.0)  # 6, 6, -
    memory.write([1, 1, 1, 0, 0], 2.0)  # 6, (6 + 2) / 2 = 4, 2
    assert memory.read([1, 0, 0, 0, 0]) == 5.0  # (6 + 4) / 2
    assert memory.read([1, 1, 1, 0, 0]) == 3.0  # (4 + 2) / 2


def test_a_sparse_memory_of_a_thousand_bits_activates_what_kanerva_computed() -> None:
    """Distances of random addresses are binomial: below 452 of 1000 bits lies about a thousandth (Kanerva 1988)."""
    rng = np.random.default_rng(2)
    memory = SparseMemory(rng.integers(0, 2, (8000, 1000), dtype=np.int8), radius=452)
    share = stats.binom.cdf(451, 1000, 0.5)
    assert share == pytest.approx(0.001, rel=0.1)
    counts = [len(memory.activated(rng.integers(0, 2, 1000, dtype=np.int8))) for _ in range(20)]
    assert abs(np.mean(counts) - 8000 * share) < 4 * np.sqrt(8000 * share / 20)


def test_a_sparse_memory_reads_near_an_address_what_was_written_there() -> None:
    rng = np.random.default_rng(3)
    memory = SparseMemory(rng.integers(0, 2, (4000, 256), dtype=np.int8), radius=112)
    addresses = rng.integers(0, 2, (20, 256), dtype=np.int8)
    values = rng.normal(size=20)
    for address, value in zip(addresses, values, strict=True):
        memory.write(address, value)
    near, far = addresses.copy(), rng.integers(0, 2, (20, 256), dtype=np.int8)
    near[:, :8] ^= 1
    read_near = np.array([memory.read(address) for address in near], dtype=np.float64)
    read_far = np.array([memory.read(address) or 0.0 for address in far])
    assert np.corrcoef(read_near, values)[0, 1] > 0.9
    assert abs(np.corrcoef(read_far, values)[0, 1]) < 0.6
