"""Tile coding against a slow one written from its definition, and what it must refuse or count."""

from __future__ import annotations

from itertools import pairwise
from math import floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS

from rtagent import Spec
from rtagent.errors import SpecError
from rtagent.features import TileCoding, Tilings
from rtagent.scenario import assemble, load

STATE = {"shoulder": Spec(low=-1.0, high=3.0), "elbow": Spec(low=0.0, high=1.0), "wrist": Spec(low=0.0, high=6.0)}


def slow_tiles(
    state: tuple[float, ...], tilings: int, tiles: list[int], displacement: str
) -> list[tuple[int, ...]]:
    """Return, for each tiling, the cell of `state`, in plain arithmetic."""
    cells = []
    for tiling in range(tilings):
        cell = [tiling]
        for place, (value, spec, count) in enumerate(zip(state, STATE.values(), tiles, strict=True)):
            shift = tiling * (2 * place + 1) if displacement == "asymmetric" else tiling
            unit = (value - spec.low) / (spec.high - spec.low)
            cell.append(floor(unit * count + shift % tilings / tilings))
        cells.append(tuple(cell))
    return cells


def states() -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*(st.floats(spec.low, spec.high) for spec in STATE.values()))


@settings(max_examples=150)
@given(
    st.lists(states(), min_size=2, max_size=20),
    st.integers(1, 9),
    st.lists(st.integers(1, 6), min_size=3, max_size=3),
    st.sampled_from(["asymmetric", "uniform"]),
)
def test_two_states_share_a_feature_where_they_share_a_tile(
    visited: list[tuple[float, ...]], tilings: int, tiles: list[int], displacement: str
) -> None:
    layer = Tilings(tilings, dict(zip(STATE, tiles, strict=True)), displacement=displacement)  # type: ignore[arg-type]
    coder = TileCoding(state=STATE, layers=(layer,))
    for one, other in pairwise(visited):
        fast = coder.encode(one).indices == coder.encode(other).indices
        slow = [
            a == b
            for a, b in zip(
                slow_tiles(one, tilings, tiles, displacement),
                slow_tiles(other, tilings, tiles, displacement),
                strict=True,
            )
        ]
        assert fast.tolist() == slow


@settings(max_examples=100)
@given(states(), st.booleans())
def test_as_many_features_are_active_as_there_are_tilings(state: tuple[float, ...], bias: bool) -> None:
    layers = (Tilings(8, 4), Tilings(4, 2, ("shoulder", "wrist")), Tilings(1, 10, ("elbow",)))
    coder = TileCoding(state=STATE, layers=layers, bias=bias)
    indices = coder.encode(state).indices
    assert len(indices) == len(set(indices.tolist())) == coder.active == 13 + bias
    assert 0 <= indices.min() <= indices.max() < coder.size
    assert coder.size == 8 * 5**3 + 4 * 3**2 + 11 + bias
    assert not bias or indices[-1] == coder.size - 1


def test_a_wrapped_signal_has_no_ends() -> None:
    coder = TileCoding(state=STATE, layers=(Tilings(8, 4, ("wrist",), wrap=("wrist",)),))
    lower, upper = coder.encode((0.0, 0.0, 0.0)).indices, coder.encode((0.0, 0.0, 6.0)).indices
    assert lower.tolist() == upper.tolist()
    assert coder.size == 8 * 4
    near = coder.encode((0.0, 0.0, 5.99)).indices
    assert np.sum(near == lower) >= 7


def test_signals_that_are_left_out_do_not_matter() -> None:
    coder = TileCoding(state=STATE, layers=(Tilings(8, 4, ("elbow",)),))
    one, other = coder.encode((-1.0, 0.3, 0.0)).indices, coder.encode((3.0, 0.3, 6.0)).indices
    assert one.tolist() == other.tolist()


def test_values_outside_are_clipped_and_counted() -> None:
    coder = TileCoding(state=STATE)
    inside, outside = coder.encode((3.0, 0.5, 0.0)).indices, coder.encode((99.0, 0.5, -7.0)).indices
    assert inside.tolist() == outside.tolist()
    assert coder.clipped == {"shoulder": 1, "elbow": 0, "wrist": 1}
    coder.encode((np.inf, 0.5, 0.0))
    assert coder.clipped["shoulder"] == 2


def places_of(coder: TileCoding, tiles: np.ndarray) -> np.ndarray:
    """Return where the coder's hash puts each tile."""
    assert coder._hash is not None
    return coder._hash(tiles)


def test_hashing_spreads_over_the_memory_and_counts_what_is_shared() -> None:
    rng = np.random.default_rng(0)
    layer = Tilings(8, 8)
    exact, hashed = TileCoding(state=STATE, layers=(layer,)), TileCoding(state=STATE, layers=(layer,), memory=1000)
    owners: dict[int, set[int]] = {}
    for _ in range(2000):
        state = tuple(rng.uniform(spec.low, spec.high) for spec in STATE.values())
        tiles = exact.encode(state).indices
        places = places_of(hashed, tiles)
        assert set(places.tolist()) == set(hashed.encode(state).indices.tolist())
        for tile, place in zip(tiles.tolist(), places.tolist(), strict=True):
            owners.setdefault(place, set()).add(tile)
    assert hashed.size == 1000
    assert len(owners) > 950, "most of the memory is used"
    assert hashed.collisions == sum(len(tiles) - 1 for tiles in owners.values())
    assert max(len(tiles) for tiles in owners.values()) < 25, "no place is crowded: 5,832 tiles on 1,000 places"


def test_tilings_that_share_a_feature_add_up_in_it() -> None:
    exact = TileCoding(state=STATE, layers=(Tilings(16, 4),))
    hashed = TileCoding(state=STATE, layers=(Tilings(16, 4),), memory=16, bias=True)
    features = hashed.encode((0.0, 0.5, 1.0))
    assert features.values is not None
    assert features.values.sum() == len(exact.encode((0.0, 0.5, 1.0)).indices) + 1
    assert len(set(features.indices.tolist())) == len(features.indices) < 17
    assert features.values[features.indices == 16].tolist() == [1.0], "the bias is nobody's to share"


def test_a_large_memory_is_shared_by_few() -> None:
    coder = TileCoding(state=STATE, layers=(Tilings(8, 2),), memory=100_000)
    for shoulder in np.linspace(-1, 3, 50):
        coder.encode((float(shoulder), 0.5, 1.0))
    assert coder.collisions <= 1


@pytest.mark.parametrize(
    ("layer", "memory", "sentence"),
    [
        (Tilings(0, 4), 0, "tilings is 0"),
        (Tilings(8, 0), 0, "signal 'shoulder' has 0 tiles"),
        (Tilings(8, {"shoulder": 4}), 0, "tiles has no entry for signal 'elbow'"),
        (Tilings(8, 4, ("hip",)), 0, "signals names the signal 'hip'; the state has shoulder, elbow, wrist"),
        (Tilings(8, 4, ("elbow",), wrap=("wrist",)), 0, "wrap names the signal 'wrist'"),
        (Tilings(8, 10**7), 0, "more than can be numbered"),
        (Tilings(8, 4), -1, "memory is -1"),
        (Tilings(8, 4), 7, "memory is 7: give .* at least as many as the 8 tilings"),
        (Tilings(8, 4, displacement="random"), 0, "displacement is 'random'"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_work_is_refused(layer: Tilings, memory: int, sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        TileCoding(state=STATE, layers=(layer,), memory=memory)


def test_no_layers_are_refused() -> None:
    with pytest.raises(SpecError, match="layers is empty"):
        TileCoding(state=STATE, layers=())


@pytest.mark.parametrize(
    "spec",
    [
        Spec(),
        Spec(low=0.0),
        Spec(low=1.0, high=1.0),
        Spec(low=-1.7e308, high=1.7e308),
        Spec(shape=(2,), low=0.0, high=1.0),
    ],
)
def test_a_signal_that_cannot_be_normalised_is_named(spec: Spec) -> None:
    with pytest.raises(SpecError, match="signal 'knee'"):
        TileCoding(state={"knee": spec})


def test_nan_and_wrong_shapes_are_refused() -> None:
    coder = TileCoding(state=STATE)
    with pytest.raises(SpecError, match="signal 'elbow' is not a number"):
        coder.encode((0.0, np.nan, 0.0))
    with pytest.raises(SpecError, match="one value for each of 3 signals"):
        coder.encode((0.0, 0.0))


def test_a_scenario_can_ask_for_tiles() -> None:
    overrides = (
        "features.type=tile_coding",
        "features.layers=[{tilings=4, tiles=2}, {tilings=2, tiles=3, signals=['wall_left']}]",
        "features.bias=true",
        "learner.type=true_online_sarsa",
        "learner.alpha=0.02",
    )
    scenario = load(SCENARIOS / "hallway.toml", overrides)
    agent = assemble(scenario).make_agent(np.random.default_rng(0))
    assert agent.features.active == 7
    assert scenario.resolved()["features"]["layers"][1]["signals"] == ["wall_left"]
