"""Compiled coders against the plain forms: the same features to the last bit, whatever is asked."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from rtagent import Spec, kernels, memory
from rtagent.errors import SpecError
from rtagent.features import FeatureCoder, KanervaCoding, SelectiveKanerva, TileCoding, Tilings
from rtagent.features.prototypes import Distance

pytest.importorskip("numba")

DISTANCES: tuple[Distance, ...] = ("euclidean", "city_block", "max")
Walk = Iterator[np.ndarray]


def cube(signals: int) -> dict[str, Spec]:
    return {f"signal {number}": Spec(low=0.0, high=1.0) for number in range(signals)}


def both(kind: type[Any], **given_: Any) -> tuple[Any, Any]:
    """Return a coder and its plain form."""
    with kernels.plain():
        slow = kind(**given_)
    return kind(**given_), slow


def assert_same(fast: FeatureCoder, slow: FeatureCoder, state: Any) -> None:
    one, other = fast.encode(state), slow.encode(state)
    assert one.indices.dtype == other.indices.dtype == np.intp
    assert one.indices.tolist() == other.indices.tolist()
    assert (one.values is None) == (other.values is None)
    if one.values is not None and other.values is not None:
        assert one.values.tolist() == other.values.tolist()


def walk(rng: np.random.Generator, signals: int, steps: int, step: float, jumps: float) -> Walk:
    point = rng.random(signals)
    for _ in range(steps):
        jump = rng.random() < jumps
        point = rng.random(signals) if jump else np.clip(point + rng.normal(0, step, signals), 0, 1)
        yield point


def grid(rng: np.random.Generator, signals: int, steps: int) -> Walk:
    yield from rng.integers(0, 5, (steps, signals)) / 4


WALKS = {
    "slow": lambda rng, signals: walk(rng, signals, 30, 0.005, 0.0),
    "creeping": lambda rng, signals: walk(rng, signals, 30, 1e-8, 0.0),
    "jumping": lambda rng, signals: walk(rng, signals, 40, 0.02, 0.2),
    "independent": lambda rng, signals: walk(rng, signals, 20, 0.0, 1.0),
    "on a grid": lambda rng, signals: grid(rng, signals, 30),
}
PROTOTYPES = {
    "scattered": lambda rng, count, signals: rng.random((count, signals)),
    "on a grid": lambda rng, count, signals: rng.integers(0, 5, (count, signals)) / 4,
    "repeated": lambda rng, count, signals: rng.random((7, signals))[rng.integers(0, 7, count)],
    "all but one place": lambda rng, count, signals: np.full((count, signals), 0.5) + 1e-9 * rng.random((count, 1)),
}


@settings(max_examples=150)
@given(
    st.sampled_from(sorted(WALKS)),
    st.sampled_from(sorted(PROTOTYPES)),
    st.sampled_from(DISTANCES),
    st.sampled_from([1, 2, 3, 5, 12]),
    st.integers(30, 400),
    st.lists(st.floats(0.02, 0.9), min_size=1, max_size=3).map(tuple),
    st.integers(1, 3),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
@pytest.mark.slow
def test_the_same_prototypes_are_chosen_with_the_same_values(
    moves: str, places: str, distance: Distance, signals: int, count: int,
    eta: tuple[float, ...], sets: int, proximity: bool, seed: int,
) -> None:  # fmt: skip
    rng = np.random.default_rng(seed)
    prototypes = PROTOTYPES[places](rng, count, signals)
    etas = tuple(max(each, 1.5 / (count // sets)) for each in eta)
    given_ = {"prototypes": prototypes, "eta": etas, "sets": sets, "distance": distance, "proximity": proximity}
    fast, slow = both(SelectiveKanerva, state=cube(signals), **given_)
    for state in WALKS[moves](rng, signals):
        assert_same(fast, slow, state)


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("signals", [2, 12])
def test_they_are_the_same_after_thousands_of_steps(distance: Distance, signals: int) -> None:
    given_ = {"prototypes": 1000, "eta": (0.04, 0.02), "distance": distance}
    fast, slow = both(SelectiveKanerva, state=cube(signals), **given_)
    for state in walk(np.random.default_rng(3), signals, 1500, 0.01, 0.01):
        assert_same(fast, slow, state)


def test_they_are_the_nearest_by_direct_differences() -> None:
    coder = SelectiveKanerva(state=cube(5), prototypes=600, eta=0.05)
    for state in walk(np.random.default_rng(5), 5, 300, 0.01, 0.05):
        distances = [
            sum((a - b) ** 2 for a, b in zip(row, state, strict=True)) for row in coder.prototypes.tolist()
        ]
        expected = sorted(sorted(range(600), key=lambda place: (distances[place], place))[:30])
        assert coder.encode(state).indices.tolist() == expected


@pytest.mark.parametrize("distance", DISTANCES)
def test_distances_that_single_precision_cannot_tell_apart_are_told_apart(distance: Distance) -> None:
    rng = np.random.default_rng(0)
    prototypes = np.full((300, 3), 0.5)
    prototypes[:, 0] = 0.75 + rng.permutation(300) * 1e-12
    fast, slow = both(SelectiveKanerva, state=cube(3), prototypes=prototypes, eta=0.1, distance=distance)
    expected = sorted(np.argsort(prototypes[:, 0])[:30].tolist())
    assert np.unique(prototypes[:, 0].astype(np.float32)).size == 1
    for state in ((0.5, 0.5, 0.5), (0.25, 0.5, 0.5)):
        assert fast.encode(state).indices.tolist() == slow.encode(state).indices.tolist() == expected


@settings(max_examples=100)
@given(st.integers(1, 20), st.sampled_from([0, 1, 2]), st.integers(0, 2**32 - 1), st.floats(1e-9, 1.0))
def test_distances_in_single_precision_keep_within_their_bound(
    signals: int, metric: int, seed: int, spread: float
) -> None:
    module: Any = kernels.load("prototypes")
    rng = np.random.default_rng(seed)
    point = rng.random(signals)
    prototypes = np.clip(point + spread * rng.normal(0, 1, (300, signals)), 0, 1)
    columns = np.zeros((signals + 1, 300), dtype=np.float32)
    columns[:-1] = prototypes.T
    module.measure(columns, 0, 300, point, metric)
    exact = [module.distance(prototype, point, metric) for prototype in prototypes]
    bounds = [module.slack(distance, signals, metric) for distance in exact]
    assert np.all(np.abs(columns[-1].astype(np.float64) - exact) <= bounds)
    assert max(bounds) < 1e-4, "a bound that says nothing would make every choice slow"


def test_a_list_of_neighbours_answers_for_many_states() -> None:
    fast, slow = both(SelectiveKanerva, state=cube(12), prototypes=2000, eta=0.025)
    selector = fast._encode.__self__
    own = selector._nearest.args[-1][0]
    anchors = []
    for state in walk(np.random.default_rng(1), 12, 500, 0.01, 0.0):
        assert_same(fast, slow, state)
        anchors.append(own[4:16].tolist())
    renewed = sum(one != other for one, other in pairwise(anchors))
    assert 3 <= renewed < 60


def test_independent_states_gather_no_list() -> None:
    coder = SelectiveKanerva(state=cube(12), prototypes=2000, eta=0.025)
    own = coder._encode.__self__._nearest.args[-1][0]  # type: ignore[attr-defined]
    for state in np.random.default_rng(1).random((20, 12)):
        coder.encode(state)
    assert own[0] == 0


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("places", sorted(PROTOTYPES))
def test_the_same_prototypes_are_within_the_radius(distance: Distance, places: str) -> None:
    rng = np.random.default_rng(2)
    for signals, radius in ((1, 0.25), (2, 0.25), (3, 0.5), (12, 1.0)):
        prototypes = PROTOTYPES[places](rng, 200, signals)
        fast, slow = both(
            KanervaCoding, state=cube(signals), prototypes=prototypes, radius=radius, distance=distance
        )
        for moves in WALKS.values():
            for state in moves(rng, signals):
                assert_same(fast, slow, state)


SIGNALS = {"shoulder": Spec(low=-1.0, high=3.0), "elbow": Spec(low=0.0, high=1.0), "wrist": Spec(low=0.0, high=6.0)}
names = st.lists(st.sampled_from(sorted(SIGNALS)), unique=True, max_size=3).map(tuple)


@st.composite
def tilings(draw: st.DrawFn) -> Tilings:
    signals = draw(names)
    wrap = draw(st.lists(st.sampled_from(signals or tuple(SIGNALS)), unique=True).map(tuple))
    tiles = {name: draw(st.integers(1, 6)) for name in SIGNALS}
    return Tilings(draw(st.integers(1, 17)), tiles, signals, wrap, draw(st.sampled_from(["asymmetric", "uniform"])))


edges = st.sampled_from([-1.0, 0.0, 0.5, 1.0, 3.0, 6.0, -0.0, 1e-320, np.nextafter(1.0, 0.0), -np.inf, np.inf, 7.0])


@settings(max_examples=150)
@given(
    st.lists(tilings(), min_size=1, max_size=3).map(tuple),
    st.sampled_from([0, 0, 51, 60, 1000]),
    st.booleans(),
    st.lists(st.tuples(*[edges | st.floats(-1.0, 6.0)] * 3), min_size=1, max_size=15),
)
@pytest.mark.slow
def test_the_same_tiles_are_active(
    layers: tuple[Tilings, ...], size: int, bias: bool, states: list[tuple[float, ...]]
) -> None:
    fast, slow = both(TileCoding, state=SIGNALS, layers=layers, memory=size, bias=bias)
    for state in states:
        assert_same(fast, slow, state)
    assert fast.collisions == slow.collisions
    assert fast.clipped == slow.clipped


CODERS = {
    "selective": lambda: SelectiveKanerva(state=SIGNALS, prototypes=300, eta=(0.1, 0.05)),
    "proximity": lambda: SelectiveKanerva(state=SIGNALS, prototypes=300, proximity=True),
    "radius": lambda: KanervaCoding(state=SIGNALS, prototypes=300),
    "tiles": lambda: TileCoding(state=SIGNALS, bias=True),
    "hashed": lambda: TileCoding(state=SIGNALS, memory=40, bias=True),
}
every_coder = pytest.mark.parametrize("name", sorted(CODERS))
each_form = pytest.mark.parametrize("plain", [True, False], ids=["plain", "compiled"])


def make(name: str, plain: bool = False) -> Any:
    if not plain:
        return CODERS[name]()
    with kernels.plain():
        return CODERS[name]()


def readings(steps: int, seed: int = 0) -> Walk:
    """Yield states, of which some lie outside."""
    for point in walk(np.random.default_rng(seed), 3, steps, 0.05, 0.1):
        yield np.array([-1.0, 0.0, 0.0]) + np.array([4.4, 1.1, 6.6]) * point


@every_coder
@each_form
def test_a_vector_is_never_written_to_again(name: str, plain: bool) -> None:
    coder = make(name, plain)
    vectors = [coder.encode(state) for state in readings(50)]
    before = [vector.indices.copy() for vector in vectors]
    values = [None if vector.values is None else vector.values.copy() for vector in vectors]
    for state in readings(200, seed=1):
        coder.encode(state)
    for vector, indices, each in zip(vectors, before, values, strict=True):
        assert np.array_equal(vector.indices, indices)
        assert each is None or np.array_equal(vector.values, each)


@every_coder
@each_form
def test_indices_are_within_the_size_each_once_and_rising_in_each_block(name: str, plain: bool) -> None:
    coder = make(name, plain)
    for state in readings(50):
        indices = coder.encode(state).indices
        assert len(set(indices.tolist())) == len(indices) <= coder.active
        assert indices.min(initial=0) >= 0
        assert indices.max(initial=0) < coder.size
        assert np.all(np.diff(indices) > 0)


@every_coder
@each_form
def test_a_state_may_come_in_any_form(name: str, plain: bool) -> None:
    coder = make(name, plain)
    array = np.array([0.5, 0.25, 3.0])
    fixed = array.copy()
    fixed.setflags(write=False)
    unaligned = np.frombuffer(b"x" + array.tobytes(), dtype=np.float64, offset=1)
    strided = np.repeat(array, 2)[::2]
    forms = (tuple(array), array.tolist(), fixed, unaligned, strided, array[::-1][::-1], array.astype(np.float32))
    expected = coder.encode(array).indices.tolist()
    assert array.tolist() == [0.5, 0.25, 3.0], "the state is not written to"
    for form in forms:
        assert coder.encode(form).indices.tolist() == expected


@every_coder
@each_form
@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        ((9.0, np.nan, 0.0), "signal 'elbow' is not a number"),
        ((0.0, 0.0), r"shape \(2,\): give one value for each of 3 signals \(shoulder, elbow, wrist\)"),
        (np.zeros(4), r"shape \(4,\)"),
        (np.zeros((1, 3)), r"shape \(1, 3\)"),
        (np.zeros((3, 1)), r"shape \(3, 1\)"),
        (0.5, r"shape \(\)"),
        ((), r"shape \(0,\)"),
        ((0.0, "bent", 0.0), "not a sequence of numbers"),
        ((0.0, (1.0, 2.0), 0.0), "not a sequence of numbers"),
    ],
)
def test_a_bad_state_is_told_and_changes_nothing(name: str, plain: bool, state: Any, sentence: str) -> None:
    coder = make(name, plain)
    before = str(coder.save())
    with pytest.raises(SpecError, match=sentence):
        coder.encode(state)
    assert str(coder.save()) == before


@every_coder
@each_form
def test_infinities_are_clipped_and_counted(name: str, plain: bool) -> None:
    coder = make(name, plain)
    at_the_ends = coder.encode((3.0, 0.0, 1.0)).indices.tolist()
    assert coder.encode((np.inf, -np.inf, 1.0)).indices.tolist() == at_the_ends
    assert coder.clipped == {"shoulder": 1, "elbow": 1, "wrist": 0}


@every_coder
@each_form
def test_a_restored_coder_goes_on_exactly(name: str, plain: bool) -> None:
    coder, other, untouched = make(name, plain), make(name, not plain), make(name, plain)
    for state in readings(60):
        coder.encode(state)
    saved = coder.save()
    for state in readings(30, seed=1):
        coder.encode(state)
    other.restore(saved)
    for state in readings(30, seed=1):
        other.encode(state)
    assert str(other.save()) == str(coder.save())
    assert sum(coder.clipped.values()) > 0
    with pytest.raises(SpecError):
        untouched.restore({"something": 1})
    assert str(untouched.save()) == str(make(name, plain).save())


def test_hashed_tiles_of_another_size_are_not_restored() -> None:
    small, large = make("hashed"), TileCoding(state=SIGNALS, memory=80)
    large.encode((9.0, 0.0, 0.0))
    with pytest.raises(SpecError, match="other settings"):
        small.restore(large.save())
    assert small.clipped == {"shoulder": 0, "elbow": 0, "wrist": 0}
    with pytest.raises(SpecError, match="no memory to hash to"):
        make("tiles").restore(large.save())


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_the_nearest_prototype_on_a_line_is_as_far_as_order_statistics_say(count: int) -> None:
    rng = np.random.default_rng(count)
    nearest = [
        abs(coder.prototypes[coder.encode(point).indices[0], 0] - point[0])
        for coder in (
            SelectiveKanerva(state=cube(1), prototypes=count, eta=1 / count, seed=seed) for seed in range(50)
        )
        for point in rng.random((200, 1))
    ]
    expected = (count + 3) / (2 * (count + 1) * (count + 2))  # gaps of K + 1 uniform points, those at the ends too
    assert np.mean(nearest) == pytest.approx(expected, rel=0.12)


def test_the_nearest_prototype_is_farther_in_more_dimensions_and_nearer_among_more() -> None:
    """Thesis, figure 6.2, with scipy's distances beside ours."""
    means: dict[tuple[int, int], float] = {}
    for signals in (1, 2, 4, 8):
        for count in (100, 1000, 4000):
            coder = SelectiveKanerva(state=cube(signals), prototypes=count, eta=1 / count, seed=signals)
            points = np.random.default_rng(9).random((200, signals))
            places = [coder.encode(point).indices[0] for point in points]
            distances = np.linalg.norm(coder.prototypes[places] - points, axis=1)
            assert distances.tolist() == pytest.approx(KDTree(coder.prototypes).query(points)[0].tolist())
            means[signals, count] = float(distances.mean())
    for signals in (1, 2, 4, 8):
        assert means[signals, 100] > means[signals, 1000] > means[signals, 4000]
    for count in (100, 1000, 4000):
        assert means[1, count] < means[2, count] < means[4, count] < means[8, count]


def test_memory_is_claimed_before_it_is_taken() -> None:
    with memory.ledger() as claims:
        coder = SelectiveKanerva(state=cube(12), prototypes=5000)
    kept = sum(each.nbytes for each in coder._encode.__self__._nearest.args)  # type: ignore[attr-defined]
    assert kept <= sum(claims.values()) * 1.01
    with pytest.raises(SpecError, match="for prototypes is more than"):
        SelectiveKanerva(state=cube(12), prototypes=10**12)
    with pytest.raises(SpecError, match="of hashed tiles is more than"):
        TileCoding(state=cube(2), memory=10**14)


CODE = """
import sys
from rtagent import Spec, kernels
from rtagent.features import KanervaCoding, SelectiveKanerva, Tabular, TileCoding
state = {{"angle": Spec(low=0.0, high=1.0)}}
{}
print("numba" in sys.modules)
"""


@pytest.mark.parametrize(
    ("made", "imported"),
    [
        ("Tabular(state={'mode': Spec.discrete(3)}).encode((1,))", False),
        ("with kernels.plain(): [c(state=state).encode((0.5,)) for c in (KanervaCoding, SelectiveKanerva)]", False),
        ("with kernels.plain(): TileCoding(state=state, memory=99).encode((0.5,))", False),
        ("SelectiveKanerva(state=state)", True),
        ("TileCoding(state=state)", True),
    ],
)
@pytest.mark.slow
def test_the_compiler_is_imported_only_where_a_kernel_is_wanted(made: str, imported: bool) -> None:
    done = subprocess.run([sys.executable, "-c", CODE.format(made)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(imported)
