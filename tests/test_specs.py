"""Specs: what fits, what does not, and values drawn from them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.specs import Spec

BOUNDS = st.one_of(st.integers(-10, 10), st.floats(-1e9, 1e9), st.sampled_from([-math.inf, math.inf, -2e6, 2e6]))


@st.composite
def specs(draw: st.DrawFn) -> Spec:
    dtype = draw(st.sampled_from(["float", "int", "bool"]))
    if dtype == "bool":
        return Spec.flag()
    low, high = sorted((draw(BOUNDS), draw(BOUNDS)))
    assume(low < math.inf and high > -math.inf)
    shape = draw(st.sampled_from([(), (1,), (3,), (2, 2)]))
    try:
        return Spec(dtype=dtype, shape=shape, low=low, high=high)
    except SpecError:
        assume(False)
        raise


@given(specs(), st.integers(0, 2**32))
@example(Spec(low=0.0, high=-0.0), 0)
@example(Spec(low=2e6), 0)
@example(Spec(dtype="int", high=-2e6), 0)
@settings(max_examples=200)
def test_what_a_spec_generates_fits_it(spec: Spec, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(5):
        value = spec.generate(rng)
        assert spec.problem(value) is None
        if spec.shape:
            assert isinstance(value, np.ndarray)
            assert value.shape == spec.shape
        else:
            assert type(value) is {"float": float, "int": int, "bool": bool}[spec.dtype]


def test_both_ends_of_a_discrete_spec_are_generated() -> None:
    rng = np.random.default_rng(0)
    assert {Spec.discrete(3).generate(rng) for _ in range(200)} == {0, 1, 2}
    assert {Spec.flag().generate(rng) for _ in range(200)} == {False, True}


@given(
    st.integers(-5, 5),
    st.integers(0, 5),
    st.one_of(st.integers(-12, 12), st.floats(-12, 12), st.sampled_from([math.nan, math.inf])),
)
@settings(max_examples=200)
def test_a_discrete_range_holds_its_whole_numbers_and_nothing_else(low: int, width: int, value: float) -> None:
    spec = Spec(dtype="int", low=low, high=low + width)
    belongs = value in range(low, low + width + 1)
    assert (spec.problem(value) is None) == belongs
    assert spec.count == width + 1


@pytest.mark.parametrize(("low", "high"), [(0.5, 2.5), (-1.5, 0.0), (0.0, 0.7)])
def test_the_count_of_a_range_that_does_not_end_at_whole_numbers_is_that_of_the_values_that_fit(
    low: float, high: float
) -> None:
    try:
        spec = Spec(dtype="int", low=low, high=high)
    except SpecError:
        return
    assert spec.count == sum(spec.problem(value) is None for value in range(-5, 6))


@pytest.mark.parametrize("spec", [Spec(), Spec(dtype="int", low=0), Spec(dtype="int", shape=(2,), low=0, high=1)])
def test_a_spec_without_finitely_many_values_has_no_count(spec: Spec) -> None:
    with pytest.raises(SpecError):
        _ = spec.count


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(SpecError, match="low 2 is above high 1"):
        Spec(low=2, high=1)
    with pytest.raises(SpecError):
        Spec(low=math.nan)


def test_an_array_of_flags_holds_nothing_but_true_and_false() -> None:
    spec = Spec(dtype="bool", shape=(2,))
    assert spec.problem(np.array([True, False])) is None
    assert spec.problem(np.array([0, 2]))
    assert {bool(each) for _ in range(20) for each in np.ravel(spec.generate(np.random.default_rng(0)))} <= {
        True,
        False,
    }


def test_a_flag_with_a_range_of_its_own_is_refused() -> None:
    with pytest.raises(SpecError):
        Spec(dtype="bool", low=2, high=5)


@pytest.mark.parametrize(
    "value", [None, "3", [1, [2]], {}, object(), 1j, 10**400, np.array(["a"]), np.ones(2), math.nan, -math.inf, 3.1]
)
def test_what_does_not_fit_a_scalar_is_said_in_words(value: object) -> None:
    problem = Spec(low=0, high=3).problem(value)
    assert problem
    with pytest.raises(SpecError, match=r"^elbow: .*expected float from 0 to 3 rad\.$"):
        Spec(low=0, high=3, unit="rad").validate(value, "elbow")


@pytest.mark.parametrize("value", [0, 3, True, 1.5, np.float32(2.0), np.int64(3), np.bool_(False), np.array(1.0)])
def test_numbers_of_every_kind_fit_a_scalar(value: object) -> None:
    assert Spec(low=0, high=3).problem(value) is None


def test_what_fits_is_validated_without_a_word() -> None:
    Spec(low=0, high=3).validate(3.0, "elbow")
    Spec.flag().validate(True)


@pytest.mark.parametrize(
    ("spec", "text"),
    [
        (Spec(low=0, high=3, unit="rad"), "float from 0 to 3 rad"),
        (Spec.discrete(4), "int from 0 to 3"),
        (Spec.flag(), "true or false"),
        (Spec(shape=(2, 3), low=-1.5), "array of shape (2, 3) of float from -1.5 to inf"),
    ],
)
def test_a_spec_describes_itself(spec: Spec, text: str) -> None:
    assert str(spec) == text


def test_an_array_fits_with_its_shape_and_range() -> None:
    spec = Spec(shape=(2,), low=0, high=1)
    assert spec.problem(np.array([0.0, 1.0])) is None
    assert spec.problem([0.0, 1.0]) is None
    assert spec.problem(np.zeros(3))
    assert spec.problem(0.5)
    assert spec.problem(np.array([0.0, 1.1]))
    assert spec.problem(np.array([0.0, math.nan]))


def test_a_flag_is_true_or_false() -> None:
    assert Spec.flag().problem(True) is None
    assert Spec.flag().problem(0.0) is None
    assert Spec.flag().problem(2)
    assert Spec.flag().problem(0.5)
    assert Spec.flag().count == 2


@given(st.floats(-100, 100), st.floats(-10, 0), st.floats(0, 10))
@settings(max_examples=100)
def test_clipping_gives_the_nearest_value_that_fits(value: float, low: float, high: float) -> None:
    spec = Spec(low=low, high=high)
    clipped = spec.clip(value)
    assert spec.problem(clipped) is None
    assert abs(clipped - value) == min(
        abs(value - each) for each in (low, high, *([value] * (low <= value <= high)))
    )
