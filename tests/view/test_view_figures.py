"""What the page is sent: decimated series, returns, histories that do not grow, and frames."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from view_records import run_record, seen_run, take

from rtagent.telemetry import records
from rtagent.telemetry.records import DemonAbout
from rtagent.units import ms, second
from rtagent.view.decimate import decimate, grid
from rtagent.view.frames import Frames, Wish, decoded
from rtagent.view.history import MOST_ROWS, History
from rtagent.view.reactions import Reactions
from rtagent.view.returns import discounted, returns
from rtagent.view.runs import MOST_RUNS, Runs
from rtagent.view.seen import MOST_HAPPENINGS

NUMBERS = st.floats(-1e6, 1e6, width=32)


@given(st.lists(st.tuples(st.integers(0, 500), NUMBERS | st.just(math.nan)), max_size=60), st.integers(1, 40))
def test_no_peak_is_lost_and_nothing_is_made_up(points: list[tuple[int, float]], columns: int) -> None:
    points.sort(key=lambda point: point[0])
    times = np.array([time for time, _ in points], np.int64)
    values = np.array([value for _, value in points], np.float32)
    shown = grid(100, 400, columns)
    pairs = decimate(times, values, shown).reshape(-1, 2)
    assert len(pairs) == shown.columns <= columns + 1
    assert shown.first <= 100
    assert shown.edges[-1] >= 400
    for (begin, end), pair in zip(pairwise(shown.edges.tolist()), pairs.tolist(), strict=True):
        inside = [value for time, value in points if begin <= time < end and not math.isnan(value)]
        assert sorted(pair) == [min(inside), max(inside)] if inside else all(map(math.isnan, pair))


def test_a_plot_that_moves_on_keeps_its_columns() -> None:
    first, second_ = grid(1003, 2003, 100), grid(1004, 2004, 100)
    assert set(second_.edges.tolist()) - set(first.edges.tolist()) <= {second_.edges[-1]}


def backwards(cumulants, gammas, terminated, truncated):  # type: ignore[no-untyped-def]
    """The definition of returns, step by step from the end, as (sum, weight of what is unknown)."""
    known: list[tuple[float, float]] = [(0.0, 0.0 if terminated[-1] else 1.0)]
    for place in range(len(cumulants) - 2, -1, -1):
        following, unknown = known[-1]
        if terminated[place]:
            known.append((0.0, 0.0))
        elif truncated[place]:
            known.append((0.0, 1.0))
        else:
            gamma = gammas[place + 1]
            known.append((cumulants[place + 1] + gamma * following, gamma * unknown))
    return np.array(known[::-1]).T


@given(st.integers(1, 70), st.data())
def test_returns_are_those_of_the_definition(steps: int, data: st.DataObject) -> None:
    some = lambda low, high: data.draw(arrays.arrays(float, steps, elements=st.floats(low, high)))  # noqa: E731
    cumulants, gammas = some(-5, 5), some(0, 0.99)
    ends = data.draw(arrays.arrays(np.int8, (2, steps), elements=st.sampled_from([0, 0, 0, 0, 1]))).astype(float)
    sums, unknown = backwards(cumulants, gammas, *ends)
    told = discounted(cumulants, gammas, *ends)
    clear = np.abs(unknown - 1e-3) > 1e-5
    assert (np.isnan(told) == (unknown >= 1e-3))[clear].all()
    assert np.nanmax(np.abs(told - sums), initial=0.0) < 1e-3


@pytest.mark.parametrize(("low", "high", "expected"), [(None, None, 5.0), (4.0, 6.0, 1.0), (6.0, None, 0.0)])
def test_the_return_of_a_constant_signal_is_the_constant(
    low: float | None, high: float | None, expected: float
) -> None:
    run = seen_run(demons=[DemonAbout("d", "x", low, high, 0.5, "second", True)])
    for step in range(400):
        take(run, "transition", step, time=step * 50 * ms, next_state=[5.0, 0.0], elapsed_ns=50 * ms)
    assert run.run is not None
    told = returns(run.tables["states"], run.run.demons[0])
    assert told is not None
    known = told[~np.isnan(told)]
    assert len(known) == pytest.approx(400 - 10 / 0.05, abs=2), "0.5 ** 10 s is 1/1024"
    assert known == pytest.approx(np.full(len(known), expected), rel=1e-3)


def test_a_return_that_cannot_be_told_is_not_shown() -> None:
    run = seen_run(demons=[DemonAbout("d", "x", None, None, None, "step", True)])
    take(run, "transition", 0, time=0)
    assert run.run is not None
    assert returns(run.tables["states"], run.run.demons[0]) is None


def test_a_history_keeps_the_newest_in_memory_that_does_not_grow() -> None:
    history, rows = History(["a"]), 2 * MOST_ROWS + 5
    for time in range(rows):
        history.add(time, [time % 1000])
    assert len(history.times) <= 2 * MOST_ROWS
    assert history.times[-1] == rows - 1
    assert (np.diff(history.times) == 1).all()
    assert (history.column("a") == history.times % 1000).all()
    assert len(History([str(each) for each in range(10_000)])._times) < 4000


def test_what_comes_late_does_not_disturb_the_order() -> None:
    history = History(["a"])
    for time in (5, 3, 9):
        history.add(time, [None])
    assert history.times.tolist() == [5, 5, 9]
    assert np.isnan(history.column("a")).all()


def test_every_reaction_is_in_the_bin_of_its_time() -> None:
    reactions, times = Reactions(), [50_000, 120_000, 121_000, 9_000_000]
    for number, time in enumerate(times):
        parts = {"sensing": 1, "deciding": 1, "acting": time - 2, "reaction": time}
        reactions.add(records.Reaction(sequence=number, time_ns=0, kind="k", stimulus_ns=0, **parts))
    told = reactions.told()
    for (low, high), count in zip(pairwise(told["edges"]), told["counts"], strict=False):
        assert count == sum(low <= time / 1000 < high for time in times)
    assert sum(told["counts"]) == told["count"] == 4


# Frames


def frames_of(**wishes: object) -> tuple[dict[str, object], list[list[float]]]:
    runs = Runs()
    runs.seen["arm/1"] = run = seen_run(began=7 * second)
    for number in range(5000):
        take(
            run, "sample", number, time=7 * second + number * ms, values={"x": number, "y": [[1.0], [number % 10]]}
        )
    take(run, "event", 0, time=8 * second, name="annotation", text="here")
    wish = Wish(run="arm/1", **wishes)  # type: ignore[arg-type]  # what the page may wish
    head, series = decoded(Frames(runs)(wish, 0.0))
    return head, [each.tolist() for each in series]


def test_a_frame_is_no_larger_than_what_is_to_be_seen() -> None:
    head, series = frames_of(series=["sample/joint/x", "sample/joint/y[1,0]"], columns=100, span=5.0)
    assert [len(each) for each in series] == [2 * head["columns"]] * 2  # type: ignore[operator]
    assert head["columns"] <= 101  # type: ignore[operator]
    assert np.nanmax(series[0]) == 4999
    assert np.nanmax(series[1]) == 9
    assert head["newest"] == pytest.approx(4.999)


def test_what_is_zoomed_into_is_seen_in_detail() -> None:
    head, series = frames_of(series=["sample/joint/x"], columns=500, span=0.02, end=1.02)
    values = np.array(series[0])[~np.isnan(series[0])]
    assert sorted(set(values.tolist())) == list(range(1000, 1021))
    assert head["first"] == pytest.approx(1.0, abs=1e-4)


def test_a_series_that_is_not_there_is_empty() -> None:
    for key in ("sample/joint/none", "return/0", "prediction/x", "nothing", "return/x"):
        _, series = frames_of(series=[key])
        assert np.isnan(series[0]).all()


def test_what_the_page_knows_is_not_sent_again() -> None:
    head, _ = frames_of()
    assert head["happened"] == [[1, 1.0, "annotation", "here"]]
    assert head["about"]["signals"][0]["unit"] == "rad"  # type: ignore[index]
    again, _ = frames_of(about=head["about"]["version"], happening=1)  # type: ignore[index]
    assert again["happened"] == []
    assert "about" not in again


@pytest.mark.parametrize("ordering", [{}, {"order": 30_000, "wait": None}])
def test_deciding_and_waiting_are_shown_of_a_run_that_learns_its_ordering(ordering: dict[str, int | None]) -> None:
    runs = Runs()
    runs.seen["arm/1"] = run = seen_run()
    take(run, "components", 0, time=ms, act=2000, observe=5000, choose=1000, **ordering)
    head, decoding = decoded(Frames(runs)(Wish(run="arm/1", series=["components/order", "components/act"]), 0.0))
    series = list(decoding)
    assert head["about"]["components"] == ["act", "observe", "choose", "learn", *ordering]
    assert np.isnan(series[0]).all() == (not ordering)
    assert np.nanmax(series[1]) == 2.0
    if ordering:
        assert np.nanmax(series[0]) == 30.0


def test_before_there_is_a_run_the_frame_says_so() -> None:
    head, series = decoded(Frames(Runs())(Wish(), 0.0))
    assert head == {"run": "", "runs": []}
    assert list(series) == []


def test_many_runs_and_many_events_do_not_grow_without_end() -> None:
    runs = Runs()
    for number in range(2 * MOST_RUNS):
        runs._new(f"arm/{number}").heard = number
    assert list(runs.seen) == [f"arm/{number}" for number in range(MOST_RUNS, 2 * MOST_RUNS)]
    run = runs.seen[runs.chosen("arm/0")]
    for number in range(2 * MOST_HAPPENINGS):
        take(run, "event", number, time=number, name="annotation", text="x")
    assert len(run.happenings) == MOST_HAPPENINGS
    assert run.happenings[-1].number == 2 * MOST_HAPPENINGS


def test_a_run_that_goes_on_is_shown_first() -> None:
    runs = Runs()
    for name, ended in (("a/1", ""), ("a/2", "done")):
        take(runs._new(name), "run", 1, record=run_record(ended=ended))
    assert runs.chosen("") == "a/1"
    assert runs.chosen("a/2") == "a/2"


def test_what_is_missing_is_counted_and_told_once_a_second() -> None:
    run = seen_run()
    for number in range(10):
        take(run, "event", 5 * number, time=number * 300 * ms, name="annotation", text="x", missed=4 * (number > 0))
    assert run.counted["missed"] == 3
    assert {row.stream: row.missed for row in run.watched.rows(0.0)}["event"] == 36
