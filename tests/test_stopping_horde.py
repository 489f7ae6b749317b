"""The table `[horde]` and the stopping task with a Horde: mistakes with their places, the schema, repeated runs."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import tomli_w
from parts import SCENARIOS

from rtagent import DeviceSpec, Observation, Sample, Spec, clock
from rtagent.__main__ import main
from rtagent.errors import ScenarioError, SpecError
from rtagent.experience import Transition
from rtagent.learning import WithHorde
from rtagent.result import Result
from rtagent.scenario import Scenario, assemble, json_schema, load
from rtagent.tasks import Stopping

PATH = SCENARIOS / "stopping_horde.toml"
GOOD = PATH.read_text()
SMALL = ("run.clock=virtual", "run.episodes=3", "horde.demons.0.bins=2", "horde.features.prototypes=100")


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scenario.toml"
    path.write_text(text)
    return path


def problems(tmp_path: Path, text: str, *overrides: str) -> list[str]:
    """Return what is wrong, each problem without the folder of its file."""
    with pytest.raises(ScenarioError) as caught:
        assemble(load(written(tmp_path, text), overrides))
    return [problem.replace(f"{tmp_path}/", "") for problem in caught.value.problems]


def line_of(text: str, part: str) -> int:
    return next(number for number, line in enumerate(text.splitlines(), 1) if part in line)


def run(scenario: Scenario, *instruments: object) -> Result:
    return clock.run(assemble(scenario).run(instruments), "virtual")


@pytest.mark.parametrize(
    ("old", "new", "sentence", "at"),
    [
        ("[horde]\n", "[horde]\nmeasurd = 3\n", "no key 'horde.measurd': did you mean 'measured'?", "measurd"),
        ("[horde]\n", '[horde]\ntype = "horde"\n', "there is no key 'horde.type'", 'type = "horde"'),
        ("lambda_ = 0.9\n\n[[horde", "lambda_ = 2.0\n\n[[horde", "lambda_ is 2.0", "[horde]"),
        ("bins = 22", "bns = 22", "no key 'horde.demons.0.bns': did you mean 'bins'?", "bns"),
        ("bins = 22", "bins = -1", "cannot be cut into -1 bins", "[horde]"),
        ('["*_position", "*_velocity", "*_load"', '["hip*"', "no signal fits 'hip*'", "[horde]"),
        ('gamma_per = "second"', 'gamma_per = "hour"', "horde.demons.0.gamma_per: Input should be", "hour"),
        ('gamma_per = "second"', 'policy = [0, 1]', "gtd, and nothing else, learns about a policy", "[horde]"),
        (
            'gamma_per = "second"', 'policy = [1]\nlearner = "gtd"', "of each of the 2 actions", "[horde]",
        ),
        ("prototypes = 500", "protypes = 500", "no key 'horde.features.protypes': did you mean 'prot", "protypes"),
        ("eta = 0.04", "eta = 2.0", "horde.features: eta 2.0 of 500 prototypes", "[horde.features]"),
        ('"selective_kanerva"', '"selective"', "no plug-in 'selective' among the features", '"selective"'),
        (
            'signals = ["*_position", "*_velocity"]', 'signal = ["*"]',
            "no key 'horde.features.input.signal': did you mean 'signals'?", 'signal = ["*"]',
        ),
        (
            'signals = ["*_position", "*_velocity"]', 'signals = ["hip*"]',
            "horde.features.input.signals: 'hip*' matches no signal of the state", 'signals = ["hip*"]',
        ),
        ('signals = ["arm.*"]', 'signals = ["leg.*"]', "'leg.*' matches no signal", "[task]"),
        ('type = "sarsa"', 'type = "td"', "TD values no actions: take one for control", "[horde]"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_its_line(tmp_path: Path, old: str, new: str, sentence: str, at: str) -> None:
    assert old in GOOD
    text = GOOD.replace(old, new, 1)
    found = problems(tmp_path, text)
    assert len(found) == 1
    assert sentence in found[0]
    assert int(found[0].split(":")[1]) == line_of(text, at)


def test_what_its_input_sets_is_not_set_for_the_coder(tmp_path: Path) -> None:
    coder = GOOD.index('type = "selective_kanerva"'), GOOD.index("[horde.features.input]")
    text = GOOD[: coder[0]] + 'type = "tile_coding"\nbias = true\n\n' + GOOD[coder[1] :]
    (found,) = problems(tmp_path, text)
    assert found.startswith(
        f"scenario.toml:{line_of(text, '[horde.features.input]')}: horde.features.input: bias is"
    )
    assert "set it in [horde.features.input] alone" in found


def test_a_horde_needs_features(tmp_path: Path) -> None:
    (found,) = problems(tmp_path, GOOD[: GOOD.index("[horde.features]")])
    assert found == f"scenario.toml:{line_of(GOOD, '[horde]')}: the key 'horde.features' is missing: add it."
    text = GOOD.replace("[horde.features", "[horde.featurs")
    assert any("no key 'horde.featurs': did you mean 'features'?" in each for each in problems(tmp_path, text))


def test_the_mistakes_of_both_learners_are_told_at_once(tmp_path: Path) -> None:
    text = GOOD.replace("gamma = 0.9", "gamma = 3.0").replace("eta = 0.04", "eta = 2.0")
    found = problems(tmp_path, text)
    assert ["learner: gamma" in found[0], "horde.features: eta" in found[1], len(found)] == [True, True, 2]


def test_more_demons_than_the_machine_has_memory_for_are_refused(tmp_path: Path) -> None:
    (found,) = problems(tmp_path, GOOD, "horde.features.prototypes=1_000_000_000", "horde.features.eta=1e-6")
    assert "horde" in found
    assert "more than the" in found


def test_a_prediction_asks_about_no_policy_where_nothing_is_done(tmp_path: Path) -> None:
    text = (SCENARIOS / "horde.toml").read_text()
    for task in ("signals", "stopping"):
        changed = text.replace('type = "signals"', f'type = "{task}"\nsignals = ["arm.*"]')
        changed = changed.replace("[devices.arm]", '[devices.joint]\ndriver = "stopping"\n\n[devices.arm]')
        (found,) = problems(tmp_path, changed.replace("bins = 22", 'learner = "gtd"\npolicy = [0, 1]\n#'))
        assert "this run only predicts, so that nothing is done" in found
        assert "put the demons into [horde]" in found
        assert int(found.split(":")[1]) > line_of(changed, "[features.input]")


def test_check_explains_the_horde_and_its_memory(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(PATH), "--set", "horde.demons.0.bins=133"]) == 0
    out = capsys.readouterr().out
    assert "beside it a Horde, over selective_kanerva features of its own" in out
    assert re.search(r"30 MB for the weights of 15,008 demons over 500 features", out)


def test_a_hundred_and_fifty_thousand_demons_take_300_megabytes(capsys: pytest.CaptureFixture[str]) -> None:
    demons = 4 * 28 * (1338 + 1)
    assert (demons, demons * 500 * 4) == (149_968, 299_936_000)
    assert "horde.demons.0.bins=1338    # 149,968: 300 MB of weights" in GOOD
    assert len(assemble(load(PATH)).make_agent(np.random.default_rng(0)).learner.horde) == 2576  # type: ignore[union-attr]


def test_the_schema_knows_the_horde() -> None:
    validator = jsonschema.Draft202012Validator(json_schema())
    validator.validate(tomllib.loads(GOOD))
    for old, new in (
        ("[horde]\n", "[horde]\nmeasurd = 3\n"),
        ("bins = 22", "bns = 22"),
        ("prototypes = 500", "protypes = 500"),
        ('"selective_kanerva"', '"selective"'),
    ):
        assert not validator.is_valid(tomllib.loads(GOOD.replace(old, new, 1))), new
    without = tomllib.loads(GOOD)
    del without["horde"]["features"]
    assert not validator.is_valid(without)


class Kept:
    """Keeps all that was learned."""

    def __init__(self) -> None:
        self.transitions: list[Transition] = []

    def learned(self, transition: Transition, delta: float, end: int) -> None:
        self.transitions.append(transition)


def test_the_agent_controls_and_predicts() -> None:
    kept = Kept()
    result = run(load(PATH, SMALL), kept)
    assert result.reaction_time.count == 3
    learner: Any = result.agents[0].learner
    assert isinstance(learner, WithHorde)
    assert learner.control.weights.any()
    assert all(learner.horde.newest[: 3 * 28 : 3]), "every signal's value is predicted"
    predictions = result.as_dict()["trials"][0]["predictions"]
    assert len(predictions) == 20
    assert all(errors["verified"] == len(kept.transitions) - 3 for errors in predictions.values())
    again: Any = assemble(load(PATH, SMALL)).make_agent(np.random.default_rng(0)).learner
    for transition in kept.transitions:
        again.update(transition)
    assert np.array_equal(again.control.weights, learner.control.weights)
    assert np.array_equal(again.horde.newest, learner.horde.newest)


def test_control_learns_and_does_what_it_would_without_the_horde(tmp_path: Path) -> None:
    alone = load(written(tmp_path, GOOD[: GOOD.index("[horde]")]), SMALL[:2])
    both, without = run(load(PATH, SMALL)), run(alone)
    assert without.agents[0].learner.weights.any()  # type: ignore[union-attr]
    assert np.array_equal(both.agents[0].learner.control.weights, without.agents[0].learner.weights)  # type: ignore[union-attr]
    assert [each.total_reward for each in both.episodes] == [each.total_reward for each in without.episodes]


def test_a_demon_asks_about_a_policy_that_is_not_the_agents(tmp_path: Path) -> None:
    text = GOOD + '\n[[horde.demons]]\nname = "go on"\nsignals = ["hand_load"]\nlearner = "gtd"\npolicy = [1, 0]\n'
    result = run(load(written(tmp_path, text), SMALL))
    learner: Any = result.agents[0].learner
    demon = learner.horde.demons[-1]
    assert (demon.name, demon.policy) == ("go on: hand_load γ=0.9", (1.0, 0.0))
    assert learner.horde.newest[-1] != 0.0


@pytest.mark.parametrize(("bound", "deferred"), [("below = 1000.0", True), ("above = 1000.0", False)])
def test_a_prediction_says_what_is_urgent(tmp_path: Path, bound: str, deferred: bool) -> None:
    urgent = f'[learn]\nurgent = {{ prediction = "hand_load γ=0.5/s", {bound} }}\n\n'
    text = GOOD.replace("[devices.joint]", f"{urgent}[devices.joint]").replace('"interruptible"', '"deferred"')
    counters = run(load(written(tmp_path, text), SMALL)).recorder.counters
    learned = counters["learned_in_place"], counters["learned_deferred"]
    assert [bool(count) for count in learned] == [not deferred, deferred]


def test_the_resolved_copy_repeats_the_run_to_the_byte(tmp_path: Path) -> None:
    sets = [word for each in SMALL for word in ("--set", each)]
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    assert main(["run", str(PATH), *sets, "--quiet", "--json", str(first)]) == 0
    copy = tmp_path / "first.scenario.toml"
    table = tomllib.loads(copy.read_text())["horde"]
    assert (table["precision"], table["demons"][0]["bins"]) == ("float32", 2)
    assert (table["features"]["prototypes"], table["features"]["input"]["outside"]) == (100, "clip")
    assert main(["run", str(copy), "--quiet", "--json", str(second)]) == 0
    assert first.read_bytes() == second.read_bytes()
    assert len(json.loads(first.read_text())["trials"][0]["predictions"]) == 20
    assert load(copy).resolved() == load(written(tmp_path, tomli_w.dumps(load(copy).resolved()))).resolved()


def test_the_horde_learns_under_the_real_clock() -> None:
    scenario = load(PATH, [*SMALL[1:], "run.episodes=1", 'devices.joint.onset=["0.1s", "0.2s"]'])
    result = clock.run(assemble(scenario).run(), "real")
    assert result.reaction_time.count == 1
    learned = sum(result.recorder.counters[how] for how in ("learned_in_place", "learned_deferred"))
    assert learned == result.episodes[0].steps
    assert any(errors.verified for errors in result.predictions(0).values())


# The task

JOINT = DeviceSpec(
    sensors={
        "position": Spec(low=0.0, high=1.0), "emergency": Spec.flag(), "stopped": Spec.flag(),
        "at_end": Spec.flag(), "reward": Spec(high=0.0),
    },
    actuators={"motion": Spec.discrete(2)},
)  # fmt: skip
ARM = DeviceSpec(sensors={"load": Spec(low=-1.0, high=1.0), "position": Spec(), "pose": Spec(shape=(2,))})
SEEN = Observation(
    0,
    {
        "joint": Sample(
            {"position": 0.25, "emergency": True, "stopped": False, "at_end": False, "reward": -1.0}, 0, 0, 0
        ),
        "arm": Sample({"load": 0.5, "position": 2.0, "pose": np.zeros(2)}, 0, 0, 0),
    },
)


@pytest.mark.parametrize(
    ("signals", "names", "state"),
    [
        ((), ["emergency"], (1.0,)),
        (("arm.*",), ["emergency", "load", "position"], (1.0, 0.5, 2.0)),
        (("*.position",), ["emergency", "joint.position", "arm.position"], (1.0, 0.25, 2.0)),
        (("joint.emergency", "arm.load"), ["emergency", "joint.emergency", "load"], (1.0, 1.0, 0.5)),
    ],
)
def test_further_signals_come_after_the_emergency(
    signals: tuple[str, ...], names: list[str], state: tuple[float, ...]
) -> None:
    task = Stopping(signals=signals)
    assert list(task.state) == ([] if signals else ["emergency"]), "what is matched is not known yet"
    task.bind({"joint": JOINT, "arm": ARM})
    task.begin()
    assert list(task.state) == names
    outcome = task.interpret(SEEN)
    assert (outcome.state, outcome.reward, outcome.terminated) == (state, -1.0, False)
    if len(names) > 1:
        assert task.state[names[-1]] is (ARM.sensors[names[-1].removeprefix("arm.")])


def test_a_pattern_that_matches_nothing_is_told() -> None:
    with pytest.raises(SpecError, match=r"'arm\.lod' matches no signal of the state: did you mean 'arm\.load'"):
        Stopping(signals=("arm.lod",)).bind({"joint": JOINT, "arm": ARM})
