"""Random streams and costs."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from rtagent import Cost, ms
from rtagent.errors import SpecError
from rtagent.streams import stream

NAMES: list[tuple[str | int, ...]] = [
    ("policy", 0),
    ("policy", 1),
    ("device", "arm", 0, 0),
    ("device", "arm", 0, 1),
    ("device", "arm", 1, 0),
    ("device", "leg", 0, 0),
    ("device", 0, 0),
    (),
]


def drawn(seed: int, *names: str | int) -> list[float]:
    return stream(seed, *names).random(4).tolist()  # type: ignore[no-any-return]  # numpy's tolist is Any


def test_the_same_seed_and_names_give_the_same_stream() -> None:
    for names in NAMES:
        assert drawn(5, *names) == drawn(5, *names)


def test_other_names_or_another_seed_give_another_stream() -> None:
    for first, second in combinations(NAMES, 2):
        assert drawn(5, *first) != drawn(5, *second)
    for names in NAMES:
        assert drawn(5, *names) != drawn(6, *names)


def test_streams_of_neighbouring_names_have_nothing_to_do_with_each_other() -> None:
    first, second = (stream(0, "device", "arm", 0, episode).random(2000) for episode in (0, 1))
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.1
    assert stats.kstest(np.concatenate([first, second]), "uniform").pvalue > 1e-4


def test_a_constant_cost_draws_nothing() -> None:
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    assert [Cost(3 * ms).draw(rng) for _ in range(5)] == [3 * ms] * 5
    assert rng.bit_generator.state == before


@pytest.mark.parametrize(
    ("cost", "law"),
    [
        (Cost(2 * ms, 6 * ms, "uniform"), stats.uniform(2 * ms, 4 * ms)),
        (Cost(20 * ms, 2 * ms, "normal"), stats.norm(20 * ms, 2 * ms)),
        (Cost(2 * ms, 6 * ms, "exponential"), stats.expon(2 * ms, 6 * ms)),
    ],
)
def test_a_cost_is_drawn_from_its_distribution(cost: Cost, law: object) -> None:
    rng = np.random.default_rng(2)
    costs = [cost.draw(rng) for _ in range(2000)]
    assert all(type(each) is int and each >= 0 for each in costs)
    assert stats.kstest(costs, law.cdf).pvalue > 1e-4  # type: ignore[attr-defined]  # scipy has no types


def test_a_cost_is_never_below_zero() -> None:
    rng = np.random.default_rng(0)
    costs = [Cost(0, ms, "normal").draw(rng) for _ in range(200)]
    assert min(costs) == 0
    assert max(costs) > 0


def test_negative_and_crossed_costs_are_refused() -> None:
    with pytest.raises(SpecError):
        Cost(-1)
    with pytest.raises(SpecError):
        Cost(1, -1, "normal")
    with pytest.raises(SpecError):
        Cost(2, 1, "uniform")
