"""Recordings: sessions, what in them cannot be used, what is guessed and told, and sentences for bad ones."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import RampWorld
from hypothesis import given
from hypothesis import strategies as st

from rtagent.errors import SpecError
from rtagent.units import ms, second
from rtagent_drivers.arm import ArmWorld
from rtagent_drivers.recorded import Recording, Signal, declared, guessed_range, record, recording_of
from rtagent_drivers.tables import Table

NAN = float("nan")
INF = float("inf")


def table(times: list[float], sessions: list[str] | None = None, **columns: list[float]) -> Table:
    numbers = {name: np.array(column, dtype=np.float64) for name, column in columns.items()}
    return Table(np.array(times, dtype=np.float64), sessions or [""] * len(times), numbers)


def ranged(**columns: list[float]) -> Recording:
    """Return a recording, a row a second, of signals from 0 to 10."""
    rows = len(next(iter(columns.values())))
    signals = {name: Signal(low=0.0, high=10.0) for name in columns}
    return recording_of(table(list(range(rows)), None, **columns), "mine", signals)


def test_rows_of_a_session_belong_together_wherever_they_are() -> None:
    recording = recording_of(table([5, 1, 6, 3], ["b", "a", "b", "a"], x=[1, 2, 3, 4]), "mine")
    assert [(each.label, each.rows.tolist(), each.times.tolist()) for each in recording.sessions] == [
        ("b", [1, 3], [0, second]),
        ("a", [2, 4], [0, 2 * second]),
    ]
    assert [each.values[:, 0].tolist() for each in recording.sessions] == [[1.0, 3.0], [2.0, 4.0]]


def test_what_is_outside_or_missing_is_counted_by_signal() -> None:
    recording = ranged(x=[1, 11, NAN, 2, -INF, 3], y=[1, NAN, 2, 10, 0, 3])
    session = recording.sessions[0]
    assert recording.damage(session, slice(None)) == {"x_outside": 2, "x_missing": 1, "y_missing": 1}
    assert recording.damage(session, slice(0, 2)) == {"x_outside": 1, "y_missing": 1}
    assert (
        "3 of 6 rows hold values outside their range, or none, and are left out: x outside 2, x missing 1, "
        "y missing 1; the first is row 2."
    ) in list(recording.notes())


def test_a_session_begins_and_ends_with_usable_rows() -> None:
    session = ranged(x=[11, NAN, 1, 12, 2, 13]).sessions[0]
    assert (session.first, session.last) == (2, 4)


def test_a_session_without_a_usable_row_is_left_out_and_told() -> None:
    recording = recording_of(
        table([0, 1, 0, 1], ["a", "a", "b", "b"], x=[20, 20, 1, 2]), "mine", {"x": Signal(low=0.0, high=10.0)}
    )
    assert [each.label for each in recording.sessions] == ["b"]
    assert "Without a usable row, and left out: session a." in list(recording.notes())


def test_gaps_are_counted_and_the_longest_is_told() -> None:
    recording = recording_of(table([0, 1, 2, 7, 8, 9, 15.5, 16.5], x=[1] * 8), "mine")
    assert recording.interval == second
    assert recording.damage(recording.sessions[0], slice(None)) == {"gaps": 1}
    assert recording.damage(recording.sessions[0], slice(0, 6)) == {}
    assert "1 gap is longer than 5 intervals; the longest, 6.5 s, ends with row 7." in list(recording.notes())


def test_the_way_from_one_session_to_the_next_is_no_gap() -> None:
    recording = recording_of(table([0, 1, 1000, 1001], ["a", "a", "b", "b"], x=[1, 2, 3, 4]), "mine")
    assert sum(int(each.gaps.sum()) for each in recording.sessions) == 0


def test_declared_ranges_are_taken_and_the_others_guessed_and_told() -> None:
    recording = recording_of(
        table([0, 1], x=[1, 3], y=[0, 10]),
        "mine",
        {"a": Signal("x", 0.0, 5.0, "rad"), "b": Signal("y", low=-1.0)},
    )
    assert (recording.specs["a"].low, recording.specs["a"].high, recording.specs["a"].unit) == (0.0, 5.0, "rad")
    assert (recording.specs["b"].low, recording.specs["b"].high) == (-1.0, 10.5)
    assert [note for note in recording.notes() if "guessed" in note] == [
        "No ranges were declared; guessed from the values: b -1 to 10.5."
    ]
    everything = recording_of(table([0, 1], x=[1, 3], y=[0, 10]), "mine")
    assert list(everything.specs) == ["x", "y"]


def test_a_guessed_range_leaves_out_wild_values() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(500.0, 100.0, 20_000)
    low, high = values.min(), values.max()
    values[::1000] = -16_245.0
    values[1::3000] = 65_535.0
    guessed = guessed_range(values)
    assert low - 100 < guessed[0] < low
    assert high < guessed[1] < high + 100


@given(st.lists(st.floats(-1e6, 1e6) | st.sampled_from([NAN, INF, -INF]), min_size=1))
def test_a_guessed_range_is_never_empty(values: list[float]) -> None:
    numbers = np.array(values)
    if np.isfinite(numbers).any():
        low, high = guessed_range(numbers)
        assert np.isfinite([low, high]).all()
        assert low < high


@given(st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=90))
def test_values_that_are_seldom_are_not_wild_where_the_rest_is_constant(values: list[float]) -> None:
    numbers = np.array([*values, *[1.0] * 20_000])
    low, high = guessed_range(numbers)
    assert low < min(values)
    assert max(values) < high


def test_columns_that_are_not_mostly_numbers_are_left_out_and_told() -> None:
    given_table = table([0, 1, 2], x=[1, 2, NAN], y=[NAN, NAN, 1], mood=[NAN] * 3)
    given_table.texts["mood"] = (3, 1, "good")
    recording = recording_of(given_table, "mine")
    assert list(recording.specs) == ["x"]
    assert "Not mostly numbers, and left out: y, mood." in list(recording.notes())


X = {"x": Signal()}


@pytest.mark.parametrize(
    ("columns", "signals", "sentence"),
    [
        (table([], x=[]), None, "mine has no rows"),
        (table([0, 1]), None, "mine has no column of numbers beside its times"),
        (table([0, 1], x=[NAN, NAN]), None, "mine has no column of numbers beside its times"),
        (table([0, 1], x=[NAN, NAN]), X, "column 'x' has no values at all"),
        (table([0, 1], x=[INF, NAN]), X, "column 'x' has no values at all"),
        (table([0, 1], elbow=[1, 2]), {"elbo": Signal()}, "no column 'elbo': did you mean 'elbow'?"),
        (table([0, 1], x=[1, 2]), {"x": Signal(low=2.0, high=1.0)}, "signal 'x': the range of a spec is empty"),
        (table([0, 1], x=[1, 2]), {"x": Signal(low=5.0, high=6.0)}, "no row in which every signal has a value"),
        (table([0, 2, 1], x=[1, 2, 3]), None, "row 3: the times in column 't' do not increase: 1 s after 2 s"),
        (table([0, 0], x=[1, 2]), None, "row 2: the times in column 't' do not increase: 0 s after 0 s"),
        (table([0, 5, 1], ["a", "b", "a"], x=[1, 2, 3]), None, ""),
        (table([0, 5, 1, 4], ["a", "b", "a", "b"], x=[1, 2, 3, 4]), None, "row 4: the times in column 't'"),
        (table([0, 1.7e12], x=[1, 2]), None, "the times in column 't' span 1.7e+12 s: give them in seconds"),
    ],
)  # fmt: skip
def test_what_cannot_be_played_is_told(columns: Table, signals: dict[str, Signal] | None, sentence: str) -> None:
    if not sentence:
        recording_of(columns, "mine", signals)
        return
    with pytest.raises(SpecError) as caught:
        recording_of(columns, "mine", signals)
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(("mine", "signal"))


@pytest.mark.parametrize("signals", [None, X])
def test_a_text_among_numbers_is_told_with_its_row(signals: dict[str, Signal] | None) -> None:
    given_table = table([0, 1, 2], x=[1, NAN, 3])
    given_table.texts["x"] = (1, 2, "oops")
    with pytest.raises(SpecError, match="mine, row 2: 'oops' in column 'x' is no number"):
        recording_of(given_table, "mine", signals)


def test_a_world_is_recorded_at_its_own_times() -> None:
    recorded = record(RampWorld(), 100 * ms, 30.0, seed=1)
    assert recorded.times.tolist() == [0.0, 0.033333333, 0.066666667, 0.1]
    assert recorded.columns["age"].tolist() == [0.0, 33_333_333.0, 66_666_667.0, 100_000_000.0]


def test_a_recorded_arm_is_within_its_declared_ranges() -> None:
    world = ArmWorld()
    recording = recording_of(record(world, 60 * second, 30.0, seed=3), "the arm", declared(world))
    assert recording.specs == world.spec.sensors
    assert recording.damage(recording.sessions[0], slice(None)) == {}
    assert list(recording.notes()) == ["the arm: 1,801 rows of 20 signals in 1 session, 60 s, one every 33.3 ms."]


@pytest.mark.parametrize(("duration", "rate", "seed"), [(-1, 30.0, 1), (1, 0.0, 1), (1, INF, 1), (1, 30.0, -1)])
def test_what_cannot_be_recorded_is_told(duration: int, rate: float, seed: int) -> None:
    with pytest.raises(SpecError, match="are needed"):
        record(RampWorld(), duration, rate, seed)
