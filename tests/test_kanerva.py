"""Kanerva coding against exhaustive search, ties and duplicates included, and against scipy's neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS
from scipy.spatial import KDTree

from rtagent import Spec
from rtagent.errors import SpecError
from rtagent.features import KanervaCoding, SelectiveKanerva, SparseMemory
from rtagent.features.prototypes import smallest
from rtagent.scenario import assemble, load

NORMS = {"euclidean": 2.0, "city_block": 1.0, "max": np.inf}


def cube(signals: int) -> dict[str, Spec]:
    return {f"signal {number}": Spec(low=0.0, high=1.0) for number in range(signals)}


def grid_points(signals: int, least: int, most: int) -> st.SearchStrategy[np.ndarray]:
    """Draw points of a coarse grid, so that distances tie and prototypes repeat."""
    rows = st.lists(st.lists(st.integers(0, 4), min_size=signals, max_size=signals), min_size=least, max_size=most)
    return rows.map(lambda drawn: np.array(drawn) / 4)


@settings(max_examples=200)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=40), st.data())
def test_the_smallest_are_those_of_a_sort_by_value_and_place(values: list[int], data: st.DataObject) -> None:
    count = data.draw(st.integers(1, len(values)))
    expected = sorted(sorted(range(len(values)), key=lambda place: (values[place], place))[:count])
    assert smallest(np.array(values, float), count).tolist() == expected


@settings(max_examples=150)
@given(grid_points(3, 4, 30), grid_points(3, 1, 1), st.sampled_from(sorted(NORMS)), st.floats(0.05, 0.9))
def test_the_active_prototypes_are_the_nearest(
    prototypes: np.ndarray, point: np.ndarray, distance: str, eta: float
) -> None:
    count = int(np.floor(len(prototypes) * eta))
    if not 1 <= count < len(prototypes):
        return
    coder = SelectiveKanerva(state=cube(3), prototypes=prototypes, eta=eta, distance=distance)  # type: ignore[arg-type]
    distances = [np.linalg.norm(prototype - point[0], NORMS[distance]) for prototype in prototypes]
    expected = sorted(sorted(range(len(prototypes)), key=lambda place: (round(distances[place], 9), place))[:count])
    active = coder.encode(point[0]).indices.tolist()
    ranks = [round(distances[place], 9) for place in active]
    assert sorted(ranks) == sorted(round(distances[place], 9) for place in expected)
    assert len(active) == len(set(active)) == coder.active == count


@pytest.mark.parametrize("distance", sorted(NORMS))
@pytest.mark.parametrize("signals", [2, 8, 12])
def test_scipy_finds_the_same_neighbours(distance: str, signals: int) -> None:
    coder = SelectiveKanerva(state=cube(signals), prototypes=2000, eta=0.025, distance=distance, seed=3)  # type: ignore[arg-type]
    tree = KDTree(coder.prototypes)
    for point in np.random.default_rng(1).random((50, signals)):
        _, neighbours = tree.query(point, 50, p=NORMS[distance])
        assert coder.encode(point).indices.tolist() == sorted(neighbours.tolist())


def test_several_ratios_are_what_each_gives_alone() -> None:
    prototypes = np.random.default_rng(0).random((400, 4))
    both = SelectiveKanerva(state=cube(4), prototypes=prototypes, eta=(0.05, 0.1, 0.025))
    alone = [SelectiveKanerva(state=cube(4), prototypes=prototypes, eta=eta) for eta in (0.1, 0.05, 0.025)]
    for point in np.random.default_rng(1).random((30, 4)):
        parts = [coder.encode(point).indices + layer * 400 for layer, coder in enumerate(alone)]
        assert both.encode(point).indices.tolist() == np.concatenate(parts).tolist()
    assert both.size == 1200
    assert both.active == 40 + 20 + 10


def test_several_sets_are_coders_of_their_own() -> None:
    prototypes = np.random.default_rng(0).random((300, 3))
    together = SelectiveKanerva(state=cube(3), prototypes=prototypes, eta=0.1, sets=3)
    apart = [SelectiveKanerva(state=cube(3), prototypes=prototypes[s : s + 100], eta=0.1) for s in (0, 100, 200)]
    for point in np.random.default_rng(1).random((30, 3)):
        parts = [coder.encode(point).indices + 100 * number for number, coder in enumerate(apart)]
        assert together.encode(point).indices.tolist() == np.concatenate(parts).tolist()
    assert (together.size, together.active) == (300, 30)


def test_real_valued_features_sum_to_c_and_fall_with_distance() -> None:
    coder = SelectiveKanerva(state=cube(3), prototypes=200, eta=0.05, proximity=True)
    for point in np.random.default_rng(1).random((30, 3)):
        features = coder.encode(point)
        assert features.values is not None
        assert features.values.sum() == pytest.approx(10.0)
        order = np.argsort(np.linalg.norm(coder.prototypes[features.indices] - point, axis=1))
        assert np.all(np.diff(features.values[order]) <= 1e-12)
        assert np.all(features.values >= 0)


def test_a_real_valued_feature_comes_and_goes_without_a_jump() -> None:
    coder = SelectiveKanerva(state=cube(2), prototypes=60, eta=0.1, proximity=True, seed=2)
    dense = np.zeros((4001, 60))
    for number, x in enumerate(np.linspace(0, 1, 4001)):
        features = coder.encode((x, 0.4))
        dense[number, features.indices] = features.values
    assert np.abs(np.diff(dense, axis=0)).max() < 0.05


def test_prototypes_at_one_place_are_all_alike() -> None:
    coder = SelectiveKanerva(state=cube(2), prototypes=np.full((10, 2), 0.5), eta=0.3, proximity=True)
    features = coder.encode((0.5, 0.5))
    assert features.indices.tolist() == [0, 1, 2]
    assert features.values is not None
    assert features.values.tolist() == [1.0, 1.0, 1.0]


@settings(max_examples=60)
@given(grid_points(2, 2, 20), grid_points(2, 1, 1), st.floats(0.01, 1.5), st.sampled_from(sorted(NORMS)))
def test_within_the_radius_is_active(
    prototypes: np.ndarray, point: np.ndarray, radius: float, distance: str
) -> None:
    coder = KanervaCoding(state=cube(2), prototypes=prototypes, radius=radius, distance=distance)  # type: ignore[arg-type]
    near = [
        place
        for place, prototype in enumerate(prototypes)
        if np.linalg.norm(prototype - point[0], NORMS[distance]) < radius
    ]
    assert coder.encode(point[0]).indices.tolist() == near


def test_the_same_seed_gives_the_same_prototypes() -> None:
    one, other, third = (SelectiveKanerva(state=cube(2), seed=seed).prototypes for seed in (1, 1, 2))
    assert np.array_equal(one, other)
    assert not np.array_equal(one, third)


def test_a_signal_is_measured_by_its_declared_range() -> None:
    wide = {"angle": Spec(low=-10.0, high=30.0)}
    coder = SelectiveKanerva(state=wide, prototypes=np.linspace(0, 1, 11)[:, None], eta=0.1)
    assert coder.encode((-10.0,)).indices.tolist() == [0]
    assert coder.encode((10.0,)).indices.tolist() == [5]
    assert coder.encode((99.0,)).indices.tolist() == [10]
    assert coder.clipped == {"angle": 1}
    with pytest.raises(SpecError, match="'angle' is not a number"):
        coder.encode((np.nan,))


@pytest.mark.parametrize(
    ("settings_", "sentence"),
    [
        ({"eta": 0.0001}, "makes 0 of them active"),
        ({"eta": 1.0}, "makes 1000 of them active"),
        ({"eta": np.nan}, "makes 0 of them active"),
        ({"eta": (0.1, 0.0)}, "makes 0 of them active"),
        ({"eta": ()}, "eta is empty"),
        ({"distance": "cosine"}, "distance is 'cosine'"),
        ({"prototypes": np.full((5, 2), np.nan)}, "outside the unit cube"),
        ({"prototypes": 1}, "prototypes is 1"),
        ({"sets": 0}, "sets is 0"),
        ({"sets": 500, "eta": 0.1}, "makes 0 of them active"),
        ({"prototypes": np.zeros((5, 3))}, r"shape \(5, 3\)"),
        ({"prototypes": np.full((5, 2), 1.5)}, "outside the unit cube"),
    ],
)
def test_what_cannot_work_is_refused(settings_: dict[str, object], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        SelectiveKanerva(state=cube(2), **settings_)  # type: ignore[arg-type]


def test_a_radius_of_nothing_is_refused() -> None:
    with pytest.raises(SpecError, match="radius is 0"):
        KanervaCoding(state=cube(2), radius=0.0)


def test_a_sparse_memory_reads_the_average_of_what_was_written_nearby() -> None:
    memory = SparseMemory([[0, 0, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]], radius=2)
    assert memory.activated([0, 0, 0, 1]).tolist() == [0, 1]
    assert memory.read([0, 0, 0, 1]) is None
    memory.write([0, 0, 0, 1], 4.0)  # to the first two
    memory.write([0, 0, 1, 1], 8.0)  # to the second only
    assert memory.read([0, 0, 0, 0]) == 4.0
    assert memory.read([0, 0, 1, 1]) == 6.0
    assert memory.read([0, 0, 0, 1]) == 5.0
    assert memory.read([1, 1, 1, 1]) is None


def test_a_sparse_memory_refuses_what_is_no_address() -> None:
    with pytest.raises(SpecError, match="rows of bits"):
        SparseMemory([[0, 2]], radius=1)
    with pytest.raises(SpecError, match="radius is 0"):
        SparseMemory([[0, 1]], radius=0)
    with pytest.raises(SpecError, match="give 2 bits"):
        SparseMemory([[0, 1]], radius=1).read([0, 1, 1])


def test_a_scenario_can_ask_for_prototypes() -> None:
    overrides = ("features.type=selective_kanerva", "features.prototypes=100", "features.eta=[0.1, 0.05]")
    agent = assemble(load(SCENARIOS / "hallway.toml", overrides)).make_agent(np.random.default_rng(0))
    assert agent.features.active == 15
