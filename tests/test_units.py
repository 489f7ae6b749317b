"""Quantities with units: written, read, and written again."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rtagent.errors import UnitError
from rtagent.units import (
    ANGLE,
    ANGULAR_VELOCITY,
    BAUD,
    FREQUENCY,
    LENGTH,
    SPEED,
    TIME,
    Quantity,
    describe,
    ms,
    second,
    seconds,
    us,
)

ALL = (TIME, FREQUENCY, ANGLE, ANGULAR_VELOCITY, LENGTH, SPEED, BAUD)
SCHEMA_TEXT = st.from_regex(r"\A ?[-+]?\d{0,3}\.?\d{0,2}(e[-+]?\d)? ?(ms|µs|μs|s|Hz|deg|)\Z")


@pytest.mark.parametrize(
    ("quantity", "text", "value"),
    [
        (TIME, "1ns", 1),
        (TIME, "1s", 1_000_000_000),
        (TIME, "50ms", 50_000_000),
        (TIME, " 1.5 s ", 1_500_000_000),
        (TIME, "2min", 120 * second),
        (TIME, "1h", 3600 * second),
        (TIME, "7us", 7 * us),
        (TIME, "7µs", 7 * us),
        (TIME, "7\N{GREEK SMALL LETTER MU}s", 7 * us),
        (TIME, "1_000ns", 1000),
        (TIME, "-3ms", -3 * ms),
        (TIME, "1e3ns", 1000),
        (TIME, ".5s", 500 * ms),
        (TIME, "0", 0),
        (TIME, 0, 0),
        (FREQUENCY, "30Hz", 30.0),
        (FREQUENCY, "2.5kHz", 2500.0),
        (FREQUENCY, "2MHz", 2e6),
        (ANGLE, "1rad", 1.0),
        (ANGLE, "90deg", math.pi / 2),
        (ANGLE, "0.5turn", math.pi),
        (ANGULAR_VELOCITY, "60rpm", 2 * math.pi),
        (ANGULAR_VELOCITY, "180deg/s", math.pi),
        (ANGULAR_VELOCITY, "2rad/s", 2.0),
        (LENGTH, "20cm", 0.2),
        (LENGTH, "20mm", 0.02),
        (LENGTH, "2m", 2.0),
        (SPEED, "5mm/s", 0.005),
        (SPEED, "5cm/s", 0.05),
        (SPEED, "5m/s", 5.0),
        (BAUD, "9600baud", 9600),
        (BAUD, "9.6kbaud", 9600),
        (BAUD, "1Mbaud", 1_000_000),
    ],
)
def test_a_quantity_is_read_in_the_unit_used_inside(quantity: Quantity, text: object, value: float | int) -> None:
    parsed = quantity.parse(text)
    assert parsed == pytest.approx(value, rel=1e-15)
    assert isinstance(parsed, int if quantity.whole else float)


@pytest.mark.parametrize("value", ["50", "ms", "", "5 m s", "five ms", "5.ms", "50 Hz", "1e400s", "nan s", "infs"])
def test_a_time_that_is_none_is_refused(value: str) -> None:
    with pytest.raises(UnitError):
        TIME.parse(value)


@pytest.mark.parametrize("value", [True, None, [1], 50, -1, 0.5, math.nan])
def test_a_value_without_a_unit_is_refused(value: object) -> None:
    with pytest.raises(UnitError):
        TIME.parse(value)


@pytest.mark.parametrize("text", ["-", "+ms", "e5ms", "1__0ms", "1_ms", "1e308h", "-1e305h"])
def test_a_badly_written_time_is_refused_with_the_error_of_units(text: str) -> None:
    with pytest.raises(UnitError):
        TIME.parse(text)


def test_a_frequency_is_never_infinite() -> None:
    with pytest.raises(UnitError):
        FREQUENCY.parse("1e308MHz")


@given(st.sampled_from(ALL), st.one_of(st.text(max_size=12), SCHEMA_TEXT))
@settings(max_examples=300)
def test_any_text_is_either_finite_or_refused_with_the_error_of_units(quantity: Quantity, text: str) -> None:
    try:
        parsed = quantity.parse(text)
    except UnitError:
        return
    assert math.isfinite(parsed)


@given(st.sampled_from([TIME, BAUD]), st.integers(-(10**18), 10**18))
@settings(max_examples=300)
def test_a_whole_quantity_survives_being_written_and_read(quantity: Quantity, value: int) -> None:
    assert quantity.parse(quantity.format(value)) == value


@given(
    st.sampled_from([quantity for quantity in ALL if not quantity.whole]),
    st.floats(allow_nan=False, allow_infinity=False),
)
@settings(max_examples=300)
def test_a_quantity_survives_being_written_and_read(quantity: Quantity, value: float) -> None:
    assert quantity.parse(quantity.format(value)) == value


@pytest.mark.parametrize("value", [np.float64(0.1), np.float32(0.5), 3])
def test_numbers_of_every_kind_survive_being_written_and_read(value: float) -> None:
    assert ANGLE.parse(ANGLE.format(value)) == value


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (50 * ms, "50ms"),
        (90 * second, "90s"),
        (120 * second, "2min"),
        (1, "1ns"),
        (1500 * us, "1500us"),
        (0, "0ns"),
    ],
)
def test_a_time_is_written_in_the_largest_unit_that_is_whole(value: int, text: str) -> None:
    assert TIME.format(value) == text


def test_the_error_of_a_unit_of_another_kind_names_the_units_that_there_are() -> None:
    with pytest.raises(UnitError, match=r"'Hz' in '50Hz' is no unit of time: use one of ns, us, ms"):
        TIME.parse("50Hz")


@pytest.mark.parametrize("quantity", ALL, ids=lambda quantity: quantity.kind)
def test_the_example_in_an_error_can_be_used(quantity: Quantity) -> None:
    for value in (None, 50, "fifty"):
        with pytest.raises(UnitError) as error:
            quantity.parse(value)
        (example,) = re.findall(r'such as "(.+)"', str(error.value))
        assert quantity.parse(example) > 0
        assert example.startswith("50")


@given(st.sampled_from(ALL), SCHEMA_TEXT)
@example(TIME, "7\N{GREEK SMALL LETTER MU}s")
@example(TIME, "5.ms")
@example(TIME, "ms")
@settings(max_examples=300)
def test_the_schema_accepts_what_is_written_with_a_unit_and_nothing_that_is_refused(
    quantity: Quantity, text: str
) -> None:
    pattern = quantity.__get_pydantic_json_schema__(None, None)["anyOf"][0]["pattern"]
    try:
        quantity.parse(text)
    except UnitError:
        assert not re.search(pattern, text)
    else:
        assert re.search(pattern, text) or text.strip().strip("-+0.e") == ""


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0 ns"),
        (999, "999 ns"),
        (1000, "1 µs"),
        (24_800_000, "24.8 ms"),
        (1_500_000_000, "1.5 s"),
        (-2 * ms, "-2 ms"),
    ],
)
def test_times_are_described_with_three_digits(value: int, text: str) -> None:
    assert describe(value) == text


@given(st.integers(-(10**13), 10**13))
@settings(max_examples=300)
def test_a_description_is_readable_and_true_to_half_a_percent(value: int) -> None:
    number, unit = describe(value).split()
    assert re.fullmatch(r"-?\d+(\.\d+)?", number)
    scale = {"ns": 1, "µs": us, "ms": ms, "s": second}[unit]
    assert float(number) * scale == pytest.approx(value, rel=5.001e-3)


def test_seconds_are_a_billion_nanoseconds() -> None:
    assert seconds(1_500_000_000) == 1.5
