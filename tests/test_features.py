"""Feature coders: which features a state has."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector
from rtagent.features import Binned, FeatureCoder, OneHot, Tabular
from rtagent.specs import Spec

DISCRETE = {"gear": Spec(dtype="int", low=-1, high=2), "pressed": Spec.flag(), "mode": Spec.discrete(3)}
STATES = list(product((-1, 0, 1, 2), (False, True), (0, 1, 2)))
CONTINUOUS = {"angle": Spec(low=-1.0, high=1.0), "speed": Spec(low=0.0, high=10.0)}
CODERS: list[FeatureCoder] = [Tabular(state=DISCRETE), OneHot(state=DISCRETE), Binned(state=DISCRETE, bins=3)]


def indices(features: FeatureVector) -> list[int]:
    assert features.values is None
    return [int(index) for index in features.indices]


def test_a_table_gives_every_state_a_feature_of_its_own() -> None:
    coder = Tabular(state=DISCRETE)
    active = [indices(coder.encode(state)) for state in STATES]
    assert sorted(active) == [[place] for place in range(coder.size)]
    assert (coder.size, coder.active) == (len(STATES), 1)


def test_one_hot_features_are_one_for_each_value_of_each_signal() -> None:
    coder = OneHot(state=DISCRETE)
    assert (coder.size, coder.active) == (4 + 2 + 3, 3)
    for gear, pressed, mode in STATES:
        assert indices(coder.encode((gear, pressed, mode))) == [gear + 1, 4 + int(pressed), 6 + mode]


@given(st.floats(-1, 1), st.floats(0, 10), st.integers(1, 7), st.integers(1, 7))
@settings(max_examples=200)
def test_a_bin_contains_the_values_that_it_is_given(angle: float, speed: float, columns: int, rows: int) -> None:
    coder = Binned(state=CONTINUOUS, bins={"angle": columns, "speed": rows})
    (index,) = indices(coder.encode((angle, speed)))
    column, row = divmod(index, rows)
    assert coder.size == columns * rows
    assert -1 + 2 * column / columns - 1e-12 <= angle <= -1 + 2 * (column + 1) / columns + 1e-12
    assert 10 * row / rows - 1e-12 <= speed <= 10 * (row + 1) / rows + 1e-12


def test_bins_are_equal_parts_and_the_upper_end_belongs_to_the_last() -> None:
    coder = Binned(state={"angle": Spec(low=-1.0, high=1.0)}, bins=4)
    edges = [-1.0, -0.75, -0.5, -0.001, 0.0, 0.499, 0.5, 1.0]
    assert [indices(coder.encode((value,)))[0] for value in edges] == [0, 0, 1, 1, 2, 2, 3, 3]


def test_a_signal_that_never_changes_has_one_bin_that_is_used() -> None:
    coder = Binned(state={"angle": Spec(low=2.0, high=2.0)}, bins=4)
    assert indices(coder.encode((2.0,))) == [0]


@pytest.mark.parametrize("coder", CODERS, ids=lambda coder: type(coder).__name__)
@given(place=st.integers(0, len(STATES) - 1))
@settings(max_examples=20)
def test_features_are_as_many_as_declared_within_the_size_and_never_written_to(
    coder: FeatureCoder, place: int
) -> None:
    features = coder.encode(STATES[place])
    assert features.indices.dtype == np.intp
    assert len(set(indices(features))) == features.indices.size == coder.active
    assert 0 <= min(indices(features)) <= max(indices(features)) < coder.size
    with pytest.raises(ValueError, match="read-only"):
        features.indices[0] = 0


@pytest.mark.parametrize("coder", CODERS, ids=lambda coder: type(coder).__name__)
def test_states_are_coded_alike_whatever_they_are_held_in(coder: FeatureCoder) -> None:
    for state in STATES[::5]:
        as_floats = tuple(float(value) for value in state)
        assert indices(coder.encode(as_floats)) == indices(coder.encode(np.array(as_floats)))
        assert indices(coder.encode(as_floats)) == indices(coder.encode(state))


@pytest.mark.parametrize("coder", CODERS, ids=lambda coder: type(coder).__name__)
@pytest.mark.parametrize("gear", [-2, 3, -1.5, 2.5, math.nan, math.inf, -math.inf])
def test_a_value_outside_its_range_is_refused_with_the_name_of_the_signal(coder: FeatureCoder, gear: float) -> None:
    with pytest.raises(SpecError, match="gear"):
        coder.encode((gear, False, 0))


@pytest.mark.parametrize("kind", [Tabular, OneHot])
def test_a_value_between_two_whole_ones_is_refused_by_a_table(kind: type[Tabular | OneHot]) -> None:
    with pytest.raises(SpecError, match="gear"):
        kind(state=DISCRETE).encode((0.5, False, 0))


@pytest.mark.parametrize("coder", CODERS, ids=lambda coder: type(coder).__name__)
def test_a_state_of_another_length_is_refused(coder: FeatureCoder) -> None:
    with pytest.raises(ValueError, match=r"shorter|longer"):
        coder.encode((0, False))


@pytest.mark.parametrize("kind", [Tabular, OneHot])
def test_a_table_over_a_continuous_signal_is_refused_with_its_name(kind: type[Tabular | OneHot]) -> None:
    with pytest.raises(SpecError, match="'angle'"):
        kind(state=CONTINUOUS)


def test_a_signal_without_a_range_cannot_be_cut_into_bins() -> None:
    with pytest.raises(SpecError, match="'angle' has no finite range"):
        Binned(state={"angle": Spec(low=0.0)})


def test_a_signal_that_is_an_array_cannot_be_cut_into_bins() -> None:
    with pytest.raises(SpecError, match="'joints'"):
        Binned(state={"joints": Spec(shape=(3,), low=0.0, high=1.0)})


@pytest.mark.parametrize("bins", [0, -1, {"speed": 3}, {"angle": 0, "speed": 3}])
def test_bad_bins_are_refused(bins: int | dict[str, int]) -> None:
    with pytest.raises(SpecError, match="'angle'"):
        Binned(state=CONTINUOUS, bins=bins)
