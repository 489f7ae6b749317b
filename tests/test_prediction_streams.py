"""Streams of signals: returns, traces, and errors of a lesson, against steps computed by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtagent.__main__ import main
from rtagent.errors import PluginError, SpecError
from rtagent.experiments.streams import Lesson, Stream, follow, named, part_error, returns, seen_ranges, step_time
from rtagent.features import SelectiveKanerva, Tabular
from rtagent.learning import TrueOnlineTD
from rtagent.specs import Spec
from rtagent_drivers.tables import Table, write_table

TWO = {"place": Spec.discrete(2)}


def lesson(states: list[int], signal: list[float], until: int = 0, ends: tuple[int, ...] = ()) -> Lesson:
    last = np.isin(np.arange(len(states)), [*ends, len(states) - 1])
    return Lesson(np.array(states, float)[:, None], np.array(signal), last, 0.5, until)


def learner(alpha: float = 0.5, lambda_: float = 0.0) -> TrueOnlineTD:
    return TrueOnlineTD(size=2, alpha=alpha, gamma=0.5, lambda_=lambda_)


def test_predictions_are_made_before_a_step_is_learned() -> None:
    """By hand, α 0.5, γ 0.5, λ 0, cumulants half of 2, 4, 2, 4: v(0) = 0.5, v(1) = 1.125, v(0) = 1.03125."""
    found = follow(lesson([0, 1, 0, 1], [2.0, 4.0, 2.0, 4.0]), Tabular(state=TWO), [learner()])
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.5, 1.125]])


def test_a_trace_reaches_back_by_gamma_lambda() -> None:
    """By hand, λ 1: after two steps δ₂ = 2 + 0.5 v(0) - v(1) moves v(0) by its trace 0.5 · 0.5, v(1) by 0.5."""
    found = follow(lesson([0, 1, 0, 0], [2.0, 4.0, 2.0, 0.0]), Tabular(state=TWO), [learner(lambda_=1.0)])
    second = 0.5 + 0.25 * (2.0 + 0.5 * 0.5 - 0.0)
    np.testing.assert_allclose(found[0, :3], [0.0, 0.0, second])


def test_nothing_is_learned_after_its_end_and_across_sessions() -> None:
    told = follow(lesson([0, 0, 0, 0, 0], [2.0] * 5, until=2), Tabular(state=TWO), [learner()])
    assert told[0, 2] > told[0, 1] > 0
    assert told[0, 2:].tolist() == [told[0, 2]] * 3
    cut = follow(lesson([0, 1, 0, 1], [2.0, 0.0, 0.0, 0.0], ends=(1,)), Tabular(state=TWO), [learner(lambda_=1.0)])
    # the first step is learned and bootstraps; the second, out of the session, is not
    assert cut[0].tolist() == [0.0, 0.0, 0.5, 0.0]


def test_what_diverges_is_told_and_takes_nothing_else_with_it() -> None:
    rng = np.random.default_rng(0)
    given = Lesson(rng.random((300, 2)), np.ones(300), np.arange(300) == 299, 0.9)
    state = {"a": Spec(low=0.0, high=1.0), "b": Spec(low=0.0, high=1.0)}
    coder = SelectiveKanerva(state=state, prototypes=100, eta=0.5)
    learners = [TrueOnlineTD(size=100, active=50, alpha=alpha, gamma=0.9, lambda_=0.9) for alpha in (50.0, 0.1)]
    wild, tame = follow(given, coder, learners)
    assert np.isnan(wild[-1])
    assert np.isfinite(tame).all()
    truth = returns(given.signal, given.last, 0.9)
    assert np.isnan(part_error(wild, truth, slice(None)))
    assert part_error(tame, truth, slice(-200, None)) < part_error(tame, truth, slice(0, 20))


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=60), st.floats(0.0, 0.95), st.integers(0, 100))
def test_a_return_is_the_sum_that_it_stands_for(signal: list[float], gamma: float, seed: int) -> None:
    values = np.array(signal)
    last = np.random.default_rng(seed).random(len(values)) < 0.1
    last[-1] = True
    found = returns(values, last, gamma)
    for row in range(len(values)):
        end = row + int(last[row:].argmax())
        rest = values[row : end + 1]
        powers = gamma ** np.arange(len(rest))
        expected = (1 - gamma) * (powers @ rest) + gamma ** len(rest) * values[end]
        assert found.values[row] == pytest.approx(expected, abs=1e-9)
        assert found.known[row] == (gamma ** len(rest) < 1e-3)


def test_an_error_is_that_of_the_rows_whose_return_is_known() -> None:
    truth = returns(np.array([1.0] * 20), np.arange(20) == 19, 0.5)
    predictions = np.zeros(20)
    predictions[-5:] = 100.0
    assert truth.known.tolist() == [True] * 11 + [False] * 9
    assert part_error(predictions, truth, slice(None)) == pytest.approx(1.0)
    assert part_error(predictions - 1.0, truth, slice(None), power=2) == pytest.approx(4.0)
    with pytest.raises(SpecError, match="too short"):
        part_error(predictions, truth, slice(-5, None))


def test_traces_are_normalised_and_begin_anew_with_each_session() -> None:
    columns = {"x": np.array([0.0, 4.0, 4.0, 4.0])}
    stream = Stream(columns, {"x": (0.0, 4.0)}, np.array([False, False, True, True]), 1.0, "mine")
    traced = stream.traced(["x"], 0.5)
    assert traced.column("x_trace").tolist() == [0.0, 0.5, 0.75, 0.5]
    assert traced.states(["x", "x_trace"]).shape == (4, 2)
    assert traced.state(["x_trace"])["x_trace"].high == 1.0


def test_ranges_that_are_seen_have_a_width() -> None:
    assert seen_ranges({"x": np.array([3.0, 1.0]), "y": np.array([2.0, 2.0])}) == {"x": (1.0, 3.0), "y": (1.5, 2.5)}


def test_a_signal_or_a_stream_that_is_not_there_is_told_with_the_nearest() -> None:
    stream = Stream({"elbow": np.zeros(1)}, {"elbow": (0.0, 1.0)}, np.array([True]), 1.0, "mine")
    with pytest.raises(SpecError, match=r"'elbwo'.*elbow"):
        stream.column("elbwo")
    with pytest.raises(PluginError, match="sorting"):
        named("sorted")


def test_the_time_of_a_step_grows_with_what_is_computed() -> None:
    rng = np.random.default_rng(0)
    given = Lesson(rng.random((400, 8)), rng.random(400), np.arange(400) == 399, 0.9)
    state = {str(number): Spec(low=0.0, high=1.0) for number in range(8)}
    times = []
    for prototypes in (100, 40_000):
        coder = SelectiveKanerva(state=state, prototypes=prototypes, eta=0.1)
        own = TrueOnlineTD(size=coder.size, active=coder.active)
        times.append(step_time(given, coder, own, 100))
    assert times[1] > 3 * times[0] > 0


def own_recording(path: Path) -> Path:
    times = np.concatenate([np.arange(50), np.arange(40)]) / 10
    angle = np.concatenate([np.arange(50.0), 100.0 + np.arange(40.0)])
    angle[10] = -16_245.0
    write_table(Table(times, ["a"] * 50 + ["b"] * 40, {"m_position": angle, "other": np.ones(90)}), path)
    return path


def test_a_recording_is_a_stream_without_its_glitches(tmp_path: Path) -> None:
    path = str(own_recording(tmp_path / "mine.csv"))
    stream = named("recording", file=path, signals={"m_position": (0.0, 200.0)})
    assert set(stream.columns) == {"m_position", "m_velocity"}
    assert stream.last.nonzero()[0].tolist() == [48, 88]
    assert stream.ranges["m_position"] == (0.0, 200.0)
    assert stream.column("m_velocity")[[0, 1, 49]] == pytest.approx([0.0, 10.0, 0.0])
    assert stream.column("m_velocity")[10] == pytest.approx(10.0)  # over two intervals
    ranged = named("recording", file=path, signals={"m_position": (0.0, 200.0), "m_velocity": (-30.0, 30.0)})
    assert ranged.ranges["m_velocity"] == (-30.0, 30.0)
    assert stream.ranges["m_velocity"] != (-30.0, 30.0)
    orders = {tuple(named("recording", file=path, shuffle=n).column("m_position")[:2]) for n in range(6)}
    assert orders == {(0.0, 1.0), (100.0, 101.0)}


@pytest.mark.slow
def test_a_run_that_was_recorded_is_a_stream(tmp_path: Path) -> None:
    recorded = str(tmp_path / "run.mcap")
    scenario = str(Path(__file__).parent.parent / "scenarios" / "sorting.toml")
    small = ["--set", "devices.arm.trials=1", "--set", "features.prototypes=100", "--set", "run.episode_steps=200"]
    assert main(["run", scenario, *small, "--record", recorded, "--quiet"]) == 0
    stream = named("recording", file=recorded)
    assert len(stream) == 201
    assert stream.rate == pytest.approx(30.0, rel=0.01)
    assert {"shoulder_position", "elbow_load", "wrist_flexion_temperature"} <= set(stream.columns)
    assert stream.column("shoulder_position")[0] == pytest.approx(1.2, abs=0.01)
