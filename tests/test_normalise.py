"""Normalisation to the unit cube: what lies outside is clipped, or masked, and counted."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Spec
from rtagent.errors import SpecError
from rtagent.features.normalise import UnitCube

STATE = {"angle": Spec(low=-1.0, high=3.0), "speed": Spec(low=0.0, high=10.0)}


def test_a_range_becomes_the_unit_interval() -> None:
    assert UnitCube(STATE)((-1.0, 10.0)).tolist() == [0.0, 1.0]
    assert UnitCube(STATE)([1.0, 2.5]).tolist() == [0.5, 0.25]


def test_what_lies_outside_is_clipped_and_counted() -> None:
    cube = UnitCube(STATE)
    assert cube((9.0, -math.inf)).tolist() == [1.0, 0.0]
    assert cube((9.0, 1.0)).tolist() == [1.0, 0.1]
    assert cube.clipped == {"angle": 2, "speed": 1}
    assert cube.masked == {"angle": 0, "speed": 0}


def test_a_state_with_a_nan_is_refused_and_counts_nothing() -> None:
    cube = UnitCube(STATE)
    with pytest.raises(SpecError, match="signal 'speed' is not a number"):
        cube((9.0, math.nan))
    assert cube.clipped == {"angle": 0, "speed": 0}


def test_a_masked_signal_keeps_its_last_value_that_was_inside() -> None:
    cube = UnitCube(STATE, "mask")
    assert cube((math.nan, 5.0)).tolist() == [0.5, 0.5], "the middle, before there was any"
    assert cube((3.0, 1.0)).tolist() == [1.0, 0.1]
    assert cube((math.inf, 2.0)).tolist() == [1.0, 0.2]
    assert cube.inside((-7.0, -0.1)).tolist() == [3.0, 2.0]
    assert cube((0.0, 0.0)).tolist() == [0.25, 0.0]
    assert cube.masked == {"angle": 3, "speed": 1}
    assert cube.clipped == {"angle": 0, "speed": 0}


@settings(max_examples=100)
@given(st.lists(st.tuples(st.floats(), st.floats()), max_size=20))
def test_masking_gives_a_point_of_the_cube_whatever_is_read(readings: list[tuple[float, float]]) -> None:
    cube, last = UnitCube(STATE, "mask"), [1.0, 5.0]
    for reading in readings:
        for place, (value, spec) in enumerate(zip(reading, STATE.values(), strict=True)):
            last[place] = value if spec.low <= value <= spec.high else last[place]
        assert cube.inside(reading).tolist() == last
    assert np.all((cube.last >= cube.low) & (cube.last <= cube.high))


def test_what_it_returned_is_not_written_to_again() -> None:
    cube = UnitCube(STATE, "mask")
    first = cube.inside((0.0, 1.0))
    cube.inside((1.0, 2.0))
    assert first.tolist() == [0.0, 1.0]


def test_a_restored_cube_goes_on() -> None:
    cube, other = UnitCube(STATE, "mask"), UnitCube(STATE, "mask")
    cube((0.0, math.nan))
    saved = cube.save()
    cube((2.0, 2.0))
    other.restore(saved)
    assert other((math.nan, math.nan)).tolist() == [0.25, 0.5]
    assert other.masked == {"angle": 1, "speed": 2}
    with pytest.raises(SpecError, match="other settings"):
        UnitCube({"angle": STATE["angle"]}).restore(saved)


@pytest.mark.parametrize("state", [(0.0,), (0.0, 1.0, 2.0), np.zeros((2, 1)), np.zeros((1, 2)), 3.0])
def test_another_shape_is_told_with_what_is_expected(state: object) -> None:
    with pytest.raises(SpecError, match=r"one value for each of 2 signals \(angle, speed\)"):
        UnitCube(STATE)(state)  # type: ignore[arg-type]


@pytest.mark.parametrize("state", ["ab", (0.0, "x"), ((0.0,), (1.0, 2.0)), (1j, 2.0)])
def test_what_is_no_number_is_told(state: object) -> None:
    with pytest.raises(SpecError, match="one value for each of 2 signals"):
        UnitCube(STATE)(state)  # type: ignore[arg-type]


def test_only_two_things_can_be_done_with_what_lies_outside() -> None:
    with pytest.raises(SpecError, match="outside is 'wrap'"):
        UnitCube(STATE, "wrap")  # type: ignore[arg-type]
