"""What stands in front of a coder: chosen signals, traces of their history, what lies outside, a bias."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Sequence
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import tomli_w
from helpers import learn
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import ROOT, SCENARIOS

from rtagent import Agent, Outcome, Spec, clock
from rtagent.errors import ScenarioError, SpecError
from rtagent.experience import FeatureVector, State
from rtagent.features import (
    Composed,
    DataTrace,
    FeatureCoder,
    Inputs,
    SelectiveKanerva,
    Tabular,
    TileCoding,
    Traced,
)
from rtagent.learning import TD, Sarsa
from rtagent.policy import Greedy
from rtagent.scenario import assemble, json_schema, load
from rtagent.scenario.model import InputTable

ARM = {
    "shoulder.angle": Spec(low=-1.0, high=3.0),
    "shoulder.load": Spec(low=0.0, high=10.0),
    "elbow.angle": Spec(low=0.0, high=1.0),
    "elbow.load": Spec(low=-20.0, high=20.0),
}
START = (0.0, 5.0, 0.5, 0.0)


class Keeps:
    """A coder that keeps what it was shown."""

    size = active = 1

    def __init__(self) -> None:
        self.seen: list[list[float]] = []

    def encode(self, state: State) -> FeatureVector:
        self.seen.append(list(state))
        return FeatureVector(np.array([0]))


# Data traces


def test_a_trace_is_as_computed_by_hand() -> None:
    trace = DataTrace([0.5, 0.75])
    for signal in (1.0, 0.0, 0.5):
        trace.add(np.array([signal, signal]))
    # 0.5: 1, 0.5, 0.25 + 0.5 = 0.75; 0.75: 1, 0.75, 0.5625 + 0.5 = 1.0625
    assert trace.values.tolist() == [0.75, 1.0625]
    assert trace.normalised.tolist() == [0.375, 0.265625]


@settings(max_examples=60)
@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60), st.floats(0.01, 0.99))
def test_a_trace_is_the_sum_of_its_history_with_powers_of_its_decay(signals: list[float], decay: float) -> None:
    trace = DataTrace([decay])
    for signal in signals:
        trace.add(np.array([signal]))
    expected = sum(decay**ago * signal for ago, signal in enumerate(reversed(signals)))
    assert trace.values[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_trace_tells_how_long_a_signal_has_had_its_value() -> None:
    """A signal that is 1 for 500 steps and 0 for 1500, over and over (thesis, section 2.3.4)."""
    trace, levels = DataTrace([0.999]), []
    for time in range(10_000):
        trace.add(np.array([float(time % 2000 < 500)]))
        levels.append(trace.normalised[0])
    period = np.array(levels[-2000:])
    assert np.all(np.diff(period[:500]) > 0)
    assert np.all(np.diff(period[500:]) < 0)
    # in the steady state a peak p is followed by p d^1500, and leads to p = p d^2000 + 1 - d^500
    peak = (1 - 0.999**500) / (1 - 0.999**2000)
    assert period[499] == pytest.approx(peak, abs=1e-4)
    assert period[-1] == pytest.approx(peak * 0.999**1500, abs=1e-4)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused_by_a_trace_and_leaves_it_as_it_was(bad: float) -> None:
    trace = DataTrace([0.5, 0.5])
    trace.add(np.array([1.0, 2.0]))
    with pytest.raises(SpecError, match="not finite"):
        trace.add(np.array([3.0, bad]))
    assert trace.values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("decay", [0.0, 1.0, -0.5, 1.5, math.nan])
def test_a_decay_is_between_0_and_1(decay: float) -> None:
    with pytest.raises(SpecError, match=r"decay is .*between 0 and 1"):
        Inputs(ARM, traces=[Traced(decay)])


# Inputs


def test_signals_are_chosen_by_patterns_in_the_order_of_the_state() -> None:
    inputs = Inputs(ARM, signals=["elbow.*", "*.angle"])
    assert list(inputs.specs) == ["shoulder.angle", "elbow.angle", "elbow.load"]
    assert inputs.specs["elbow.load"] is ARM["elbow.load"]
    assert inputs((1.0, 2.0, 0.5, -20.0)).tolist() == [1.0, 0.5, -20.0]
    assert list(Inputs(ARM).specs) == list(ARM)


def test_a_name_with_brackets_matches_itself() -> None:
    assert list(Inputs({"load[0]": Spec(low=0, high=1)}, signals=["load[0]"]).specs) == ["load[0]"]


@pytest.mark.parametrize("given_", [{"signals": ["sholder.load"]}, {"traces": [Traced(0.5, ("sholder.load",))]}])
def test_a_pattern_that_matches_nothing_is_told(given_: dict[str, list[str]]) -> None:
    with pytest.raises(SpecError, match=r"'sholder\.load' matches no signal .*did you mean 'shoulder\.load'"):
        Inputs(ARM, **given_)  # type: ignore[arg-type]


def test_traces_come_after_the_signals_normalised_to_the_unit_interval() -> None:
    inputs = Inputs(ARM, signals=["*.angle"], traces=[Traced(0.5), Traced(0.75, ("elbow.*",))])
    assert list(inputs.specs)[2:] == [
        "shoulder.angle.trace(0.5)", "elbow.angle.trace(0.5)", "elbow.angle.trace(0.75)", "elbow.load.trace(0.75)",
    ]  # fmt: skip
    assert all((spec.low, spec.high) == (0.0, 1.0) for spec in list(inputs.specs.values())[2:])
    inputs((3.0, 0.0, 0.5, 20.0))
    # in the unit cube: 1, 0.5, and the load 1; then 0, 1, and the load 0.5
    seen = inputs((-1.0, 0.0, 1.0, 0.0))
    assert seen[:2].tolist() == [-1.0, 1.0]
    assert inputs.trace.values.tolist() == [0.5, 1.25, 1.375, 1.25]
    assert seen[2:].tolist() == [0.25, 0.625, 0.34375, 0.3125]


@settings(max_examples=60)
@given(
    st.lists(st.tuples(*[st.floats()] * 4), min_size=1, max_size=40),
    st.sampled_from([0.001, 0.5, 0.9, 0.999]),
)
def test_whatever_is_read_a_coder_is_shown_what_its_specs_promise(
    readings: list[tuple[float, ...]], decay: float
) -> None:
    inputs = Inputs(ARM, traces=[Traced(decay)], outside="mask")
    for reading in readings:
        for value, spec in zip(inputs(reading), inputs.specs.values(), strict=True):
            assert spec.problem(value) is None
    for place, (name, spec) in enumerate(ARM.items()):
        assert inputs.masked[name] == sum(not spec.low <= reading[place] <= spec.high for reading in readings)


@pytest.mark.parametrize("decay", [0.9, 0.999, 0.09, 0.21])  # the last two round to above 1
def test_a_signal_that_stays_at_its_end_never_leaves_the_unit_interval(decay: float) -> None:
    inputs = Inputs({"x": Spec(low=0.1, high=0.7)}, traces=[Traced(decay)])
    levels = [inputs((0.7,))[1] for _ in range(30_000)]
    assert levels[-1] == pytest.approx(1.0)
    assert max(levels) <= 1.0


def test_a_masked_reading_counts_and_the_trace_goes_on_with_the_last_one_inside() -> None:
    inputs = Inputs(ARM, traces=[Traced(0.5, ("shoulder.load",))], outside="mask")
    inputs((0.0, 10.0, 0.5, 0.0))
    poisoned = inputs((0.0, math.nan, 0.5, 0.0))
    assert poisoned.tolist() == [0.0, 10.0, 0.5, 0.0, 0.75]
    assert inputs((0.0, 99.0, 0.5, math.inf))[4] == 0.875
    assert inputs.masked == {"shoulder.angle": 0, "shoulder.load": 2, "elbow.angle": 0, "elbow.load": 1}


def test_a_clipped_reading_counts_and_a_nan_is_refused_without_a_trace_of_it() -> None:
    inputs = Inputs(ARM, traces=[Traced(0.5)])
    assert inputs((0.0, 99.0, 0.5, -math.inf)).tolist()[:4] == [0.0, 10.0, 0.5, -20.0]
    before = inputs.trace.values.copy()
    with pytest.raises(SpecError, match=r"'elbow\.angle' is not a number"):
        inputs((0.0, 1.0, math.nan, 0.0))
    assert inputs.trace.values.tolist() == before.tolist()
    assert inputs.clipped == {"shoulder.angle": 0, "shoulder.load": 1, "elbow.angle": 0, "elbow.load": 1}


def test_only_signals_that_are_read_need_a_range_and_are_counted() -> None:
    state = {"image": Spec(shape=(2, 2)), "time": Spec(), "load": Spec(low=0, high=1), "age": Spec(low=0)}
    inputs = Inputs(state, signals=["load"])
    assert inputs((np.zeros((2, 2)), 3.0, 0.5, 0.0)).tolist() == [0.5]  # type: ignore[arg-type]  # an array in a state
    assert list(inputs.clipped) == ["load"]
    with pytest.raises(SpecError, match="'image' is an array"):
        Inputs(state, signals=["image"])
    with pytest.raises(SpecError, match="'age' has no finite range"):
        Inputs(state, signals=["load"], traces=[Traced(0.5, ("age",))])
    with pytest.raises(SpecError, match="2 values: give one for each of 4"):
        inputs((0.0, 0.5))


def test_a_signal_is_traced_once_with_one_decay() -> None:
    with pytest.raises(SpecError, match=r"two inputs called 'elbow.load.trace\(0.5\)'"):
        Inputs(ARM, traces=[Traced(0.5), Traced(0.5, ("elbow.load",))])


def test_what_was_returned_is_not_written_to_again() -> None:
    for outside in ("clip", "mask"):
        inputs = Inputs(ARM, traces=[Traced(0.5)], outside=outside)  # type: ignore[arg-type]  # one of the two
        first = inputs(START)
        kept = first.copy()
        inputs((1.0, 1.0, 1.0, 1.0))
        assert first.tolist() == kept.tolist()


# Composed coders


def test_a_coder_is_shown_the_signals_in_their_own_units_and_the_traces() -> None:
    coder = Keeps()
    composed = Composed(Inputs(ARM, signals=["*.load"], traces=[Traced(0.5)]), coder)
    composed.encode(START)
    assert coder.seen == [[5.0, 0.0, 0.25, 0.25]]


def coders(inputs: Inputs) -> list[FeatureCoder]:
    state = inputs.specs
    return [
        TileCoding(state=state),
        TileCoding(state=state, memory=64),
        SelectiveKanerva(state=state, prototypes=50, eta=0.2, proximity=True),
    ]


@pytest.mark.parametrize("kind", range(3))
def test_with_a_bias_the_last_feature_is_always_active(kind: int) -> None:
    def made() -> tuple[Composed, Composed]:
        plain, biased = (Inputs(ARM, signals=["*.load"], traces=[Traced(0.9)]) for _ in range(2))
        return Composed(plain, coders(plain)[kind]), Composed(biased, coders(biased)[kind], bias=True)

    plain, biased = made()
    assert (biased.size, biased.active) == (plain.size + 1, plain.active + 1)
    for state in np.random.default_rng(1).random((20, 4)):
        without, with_bias = plain.encode(state), biased.encode(state)
        assert with_bias.indices.tolist() == [*without.indices.tolist(), plain.size]
        if without.values is None:
            assert with_bias.values is None
        else:
            assert with_bias.values is not None
            assert with_bias.values.tolist() == [*without.values.tolist(), 1.0]


def test_a_table_may_see_some_of_the_signals_only() -> None:
    state = {"wall": Spec.flag(), "angle": Spec(), "place": Spec.discrete(3)}
    inputs = Inputs(state, signals=["wall", "place"])
    composed = Composed(inputs, Tabular(state=inputs.specs), bias=True)
    assert composed.size == 7
    assert composed.encode((1.0, 77.7, 2.0)).indices.tolist() == [5, 6]
    assert composed.encode((1.0, 77.7, 9.0)).indices.tolist() == [5, 6]
    assert composed.clipped == {"wall": 0, "place": 1}
    assert composed.masked == {"wall": 0, "place": 0}


def composed_arm() -> Composed:
    inputs = Inputs(ARM, traces=[Traced(0.9), Traced(0.99)], outside="mask")
    return Composed(inputs, Keeps())


def states(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(-25, 25, (count, 4))
    drawn[rng.random((count, 4)) < 0.2] = math.nan
    return drawn


def test_a_restored_coder_goes_on_as_if_nothing_had_been() -> None:
    one, other = composed_arm(), composed_arm()
    for state in states(30, 1):
        one.encode(state)
    saved = one.save()
    for state in states(5, 2):
        one.encode(state)
    for state in states(9, 3):
        other.encode(state)
    other.restore(saved)
    for state in states(5, 2):
        other.encode(state)
    assert isinstance(one.coder, Keeps)
    assert isinstance(other.coder, Keeps)
    assert other.coder.seen[-5:] == one.coder.seen[-5:]
    assert other.masked == one.masked


def test_what_was_saved_of_something_else_is_refused_and_changes_nothing() -> None:
    one, another = composed_arm(), composed_arm()
    for state in states(10, 1):
        one.encode(state)
    before = one.save()
    narrow = Composed(Inputs(ARM, signals=["*.load"], traces=[Traced(0.5)]), Keeps()).save()
    half = {"inputs": {"trace": another.save()["inputs"]["trace"], "cube": narrow["inputs"]["cube"]}}
    for wrong in ({}, {"inputs": {}}, narrow, half):
        with pytest.raises(SpecError, match=r"something else|other settings"):
            one.restore(wrong)
        assert one.inputs.trace.values.tolist() == before["inputs"]["trace"]["values"].tolist()
        assert one.masked == dict(zip(ARM, before["inputs"]["cube"]["masks"].tolist(), strict=True))


# Episodes, and how often an agent encodes


def test_nothing_of_an_episode_is_left_in_the_next() -> None:
    composed = composed_arm()
    agent = Agent(composed, TD(size=1))
    unseen = (math.nan,) * 4
    for state in states(20, 1):
        agent.observe(Outcome(tuple(state)), 0)
    agent.begin()
    agent.observe(Outcome(unseen), 0)
    fresh = composed_arm()
    fresh.encode(unseen)
    assert isinstance(composed.coder, Keeps)
    assert isinstance(fresh.coder, Keeps)
    assert composed.coder.seen[-1] == fresh.coder.seen[-1]
    assert sum(composed.masked.values()) > 4, "the counts are of the whole run"


def test_a_coder_that_remembers_behind_the_inputs_is_told_of_the_episode_too() -> None:
    begun = []

    class Remembers(Keeps):
        def begin(self) -> None:
            begun.append(len(self.seen))

    agent = Agent(Composed(Inputs(ARM), Remembers()), TD(size=1))
    agent.observe(Outcome(START), 0)
    agent.begin()
    assert begun == [0, 1]


@settings(max_examples=50)
@given(st.lists(st.sampled_from(["observe", "choose", "act", "learn"]), max_size=40))
def test_an_agent_encodes_each_observation_once_whether_it_closes_a_step_or_refreshes_one(
    steps: Sequence[str],
) -> None:
    coder = Keeps()
    agent = Agent(Composed(Inputs(ARM, traces=[Traced(0.5)]), coder), Sarsa(size=1, actions=2), Greedy())
    observed, fresh, chosen = 0, False, False
    for step in steps:
        if step == "observe":
            agent.observe(Outcome(START), observed)
            observed, fresh = observed + 1, True
        elif step == "choose" and fresh:
            agent.choose()
            fresh, chosen = False, True
        elif step == "act" and chosen:
            agent.acted()
        elif step == "learn" and agent.queue:
            learn(agent)
    assert len(coder.seen) == observed


# Scenarios

HALLWAY = (SCENARIOS / "hallway.toml").read_text()
TRACED = (
    HALLWAY
    + """
[features.input]
signals = ["wall*"]
outside = "mask"
bias = true

[[features.input.traces]]
decay = 0.9

[[features.input.traces]]
decay = 0.99
signals = ["wall_left"]
"""
)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scenario.toml"
    path.write_text(text.replace('type = "tabular"', 'type = "tile_coding"', 1))
    return path


def test_a_scenario_can_put_inputs_in_front_of_a_coder(tmp_path: Path) -> None:
    scenario = load(written(tmp_path, TRACED))
    agent = assemble(scenario).make_agent(np.random.default_rng(0))
    assert isinstance(agent.features, Composed)
    assert list(agent.features.inputs.specs) == ["wall_left", "wall_left.trace(0.9)", "wall_left.trace(0.99)"]
    assert agent.features.active == 9
    agent.features.encode((math.nan,))
    assert agent.features.masked == {"wall_left": 1}


def test_each_agent_has_traces_of_its_own(tmp_path: Path) -> None:
    assembly = assemble(load(written(tmp_path, TRACED)))
    one, other = (assembly.make_agent(np.random.default_rng(0)).features for _ in range(2))
    one.encode((1.0,))
    assert isinstance(other, Composed)
    assert not other.inputs.trace.values.any()


def test_a_scenario_without_an_input_has_the_bare_coder(tmp_path: Path) -> None:
    agent = assemble(load(written(tmp_path, HALLWAY))).make_agent(np.random.default_rng(0))
    assert type(agent.features) is TileCoding


def test_a_scenario_with_inputs_runs_and_its_resolved_copy_does_the_same(tmp_path: Path) -> None:
    overrides = ["run.clock=virtual", "run.episodes=3", "run.episode_time=5s"]
    scenario = load(written(tmp_path, TRACED), overrides)
    copy = tmp_path / "copy.toml"
    copy.write_text(tomli_w.dumps(scenario.resolved()))
    results = [json.dumps(clock.run(assemble(each).run(), "virtual").as_dict()) for each in (scenario, load(copy))]
    assert results[0] == results[1]
    assert load(copy).resolved() == scenario.resolved()


@pytest.mark.parametrize(
    ("old", "new", "at", "sentence"),
    [
        ('["wall*"]', '["wal_left"]', "signals = [", "'wal_left' matches no signal of the state: did you mean"),
        ('["wall_left"]', '["left"]', 'signals = ["left"]', "'left' matches no signal"),
        ('outside = "mask"', 'outside = "drop"', "outside", "should be 'clip' or 'mask'"),
        ("bias = true", "bais = true", "bais", "no key 'features.input.bais': did you mean 'bias'?"),
        ("decay = 0.99", "deacy = 0.99", "deacy", "no key 'features.input.traces.1.deacy': did you mean 'decay'?"),
        ("decay = 0.99", "decay = 1.5", "[features.input]", "decay is 1.5: give a number between 0 and 1."),
        ("decay = 0.99", "decay = 0.9", "[features.input]", "two inputs called 'wall_left.trace(0.9)'"),
        ('"tabular"', '"tile_coding"\nbias = true', "[features.input]", "bias is set for the coder"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_its_line(tmp_path: Path, old: str, new: str, at: str, sentence: str) -> None:
    path = written(tmp_path, TRACED.replace(old, new))
    with pytest.raises(ScenarioError) as caught:
        assemble(load(path))
    line = next(number for number, text in enumerate(path.read_text().splitlines(), 1) if at in text)
    assert [
        problem
        for problem in caught.value.problems
        if problem.startswith(f"{path}:{line}: ") and sentence in problem
    ]


def test_all_patterns_that_match_nothing_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        assemble(load(written(tmp_path, TRACED.replace("wall*", "x").replace('["wall_left"]', '["y"]'))))
    assert len(caught.value.problems) == 2
    assert "'x'" in caught.value.problems[0]
    assert "'y'" in caught.value.problems[1]


def test_the_schema_knows_the_input() -> None:
    validator = jsonschema.Draft202012Validator(json_schema())
    validator.validate(tomllib.loads(TRACED))
    for old, new in (("bias = true", "bais = true"), ('"mask"', '"drop"'), ("decay = 0.99", "deacy = 1")):
        assert not validator.is_valid(tomllib.loads(TRACED.replace(old, new)))


def test_every_key_of_the_input_is_on_the_page_on_scenarios() -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text().split("### `[features.input]`")[1].split("\n## ")[0]
    assert [key for key in InputTable.model_fields if f"| `{key}` |" not in page] == []
    example = tomllib.loads(page.split("```toml")[1].split("```")[0])["features"]["input"]
    assert InputTable.model_validate(example).traces == [Traced(0.999, ("*.load",))]
