"""Scenario files: every error at once, each with its place and a cure; resolved copies; the schema."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from pathlib import Path

import jsonschema
import pytest
import tomli_w
from parts import SCENARIOS

from rtagent import clock, ms, plugins
from rtagent.errors import PluginError, ScenarioError
from rtagent.policy import Greedy
from rtagent.scenario import Scenario, assemble, json_schema, load

GOOD = (SCENARIOS / "stopping.toml").read_text()


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


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scenario_of_ours_is_right(path: Path) -> None:
    assembly = assemble(load(path))
    assert bool(assembly.task.actions) == assembly.schedule.acts


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("seed = 1", "sed = 1", "there is no key 'run.sed': did you mean 'seed'?"),
        ("seed = 1", "seed = -1", "run.seed: Input should be greater than or equal to 0."),
        ('clock = "real"', 'clock = "reel"', "run.clock: Input should be 'real' or 'virtual'."),
        ('preset = "reactive"', 'preset = "reactiv"', "there is no preset 'reactiv': did you mean 'reactive'?"),
        ('learn_delay = "50ms"', "learn_delay = 50", '50 has no unit: write a time such as "50ms".'),
        (
            'learn_delay = "50ms"',
            'learn_delay = "50Hz"',
            "'Hz' in '50Hz' is no unit of time: use one of ns, us, ms",
        ),
        ('learn_delay = "50ms"', 'learn_delay = "fast"', "'fast' is not a number with a unit"),
        ('learn_delay = "50ms"', 'learn_delay = "-50ms"', "schedule.learn_delay is negative"),
        ('driver = "stopping"', 'driver = "stoping"', "'stoping' among the drivers: did you mean 'stopping'?"),
        ('velocity = "100deg/s"', 'velocity = "1m/s"', "'m/s' in '1m/s' is no unit of angular velocity"),
        ('velocity = "100deg/s"', 'velocity = "-1deg/s"', "travel, velocity and reward_unit are above 0"),
        ('["0.5s", "1.5s"]', '["1.5s", "0.5s"]', "onset is [earliest, latest]"),
        ('["0.5s", "1.5s"]', '["0.5s", "9s"]', "the latest onset is after the end of the travel"),
        ('["0.5s", "1.5s"]', '["0.5s"]', "onset"),
        ('travel = "300deg"', 'travl = "300deg"', "there is no key 'devices.joint.travl': did you mean 'travel'?"),
        ("alpha = 0.1", "alpha = 0", "alpha is 0.0: give a step size above 0"),
        ("alpha = 0.1", 'alpha = "x"', "learner.alpha: Input should be a valid number"),
        ("gamma = 0.9", "gamma = 1.5", "gamma is 1.5: give a number from 0 to 1"),
        (
            'type = "sarsa"',
            'type = "td"\nlambda = 0.5',
            "there is no key 'learner.lambda': did you mean 'lambda_'?",
        ),
        ('type = "greedy"', 'type = "epsilon_greedy"\nepsilon = 2.0', "epsilon is 2.0"),
        ('type = "tabular"', 'type = "binned"\nbins = 0', "give at least 1"),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    assert old in GOOD
    found = problems(tmp_path, GOOD.replace(old, new, 1))
    assert len(found) == 1
    assert sentence in found[0]
    assert found[0].startswith("scenario.toml:")


@pytest.mark.parametrize(
    ("old", "new", "table"),
    [
        ("alpha = 0.1", "alpha = 0", "[learner]"),
        ('type = "greedy"', 'type = "epsilon_greedy"\nepsilon = 2.0', "[policy]"),
        ('type = "tabular"', 'type = "binned"\nbins = 0', "[features]"),
        ('velocity = "100deg/s"', 'velocity = "-1deg/s"', "[devices.joint]"),
        ('preset = "reactive"', 'order = ["observe"]', "[schedule]"),
    ],
)
def test_what_a_part_refuses_is_told_with_the_line_of_its_table(
    tmp_path: Path, old: str, new: str, table: str
) -> None:
    text = GOOD.replace(old, new, 1)
    assert int(problems(tmp_path, text)[0].split(":")[1]) == line_of(text, table)


def test_a_plugin_that_raises_anything_is_told_in_a_sentence(tmp_path: Path) -> None:
    class Moody:
        """A policy that cannot be made."""

        def __init__(self) -> None:
            raise KeyError("mood")

    plugins.register("policies", "moody", Moody)
    found = problems(tmp_path, GOOD.replace('type = "greedy"', 'type = "moody"'))
    assert len(found) == 1
    assert "policy: KeyError('mood')" in found[0]


def test_the_line_is_that_of_the_key(tmp_path: Path) -> None:
    text = GOOD.replace("gamma = 0.9", "gama = 0.9").replace('travel = "300deg"', 'travel = "300"')
    found = problems(tmp_path, text)
    assert [int(each.split(":")[1]) for each in found] == [line_of(text, 'travel = "300"'), line_of(text, "gama")]


def test_all_mistakes_are_told_at_once(tmp_path: Path) -> None:
    text = GOOD.replace("seed = 1", "sed = 1").replace('"50ms"', "50").replace("300deg", "300degrees")
    text = text.replace('type = "sarsa"', 'type = "sarsaparilla"').replace("[policy]", "[polizy]")
    found = problems(tmp_path, text)
    assert len(found) == 5
    lines = [int(each.split(":")[1]) for each in found]
    assert lines == sorted(lines)


def test_tables_that_are_missing_are_told(tmp_path: Path) -> None:
    found = problems(tmp_path, "name = 'nothing'\n")
    for table in ("schedule", "devices", "task", "features", "learner"):
        assert any(f"the key '{table}' is missing" in each for each in found)


@pytest.mark.parametrize("text", ["[run\nseed = 1\n", "seed = = 1\n", 'name = "no end\n', "a = 1\na = 2\n", "\x00"])
def test_what_is_not_toml_is_told_with_its_line(tmp_path: Path, text: str) -> None:
    found = problems(tmp_path, GOOD + text)
    assert all(each.startswith("scenario.toml:") for each in found)
    assert "this is not TOML" in found[0]
    assert int(found[0].split(":")[1]) > line_of(GOOD, "[policy]")


def test_several_breaks_are_told_together(tmp_path: Path) -> None:
    text = GOOD.replace("seed = 1", "seed = = 1").replace("[task]", "[task")
    assert [int(each.split(":")[1]) for each in problems(tmp_path, text)][:1] == [line_of(text, "seed = = 1")]
    assert len(problems(tmp_path, text)) >= 2


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="there is no such file"):
        load(tmp_path / "nowhere.toml")


def test_a_file_that_is_no_text_is_told(tmp_path: Path) -> None:
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="cannot be read"):
        load(path)


def test_a_mistake_in_an_override_names_the_override(tmp_path: Path) -> None:
    found = problems(tmp_path, GOOD, "schedule.learn_delay=50", "run.sed=3", "nonsense", "name.first=x")
    assert found == [
        "--set nonsense: write it as key=value, such as --set run.seed=2.",
        "--set name.first=x: 'name' is a value, not a table.",
    ]
    found = problems(tmp_path, GOOD, "schedule.learn_delay=50", "run.sed=3")
    assert found == [
        "--set run.sed=3: there is no key 'run.sed': did you mean 'seed'?",
        '--set schedule.learn_delay=50: schedule.learn_delay: 50 has no unit: write a time such as "50ms".',
    ]


def test_any_key_can_be_set(tmp_path: Path) -> None:
    overrides = (
        "schedule.learn_delay=250ms",
        "devices.joint.velocity=90deg/s",
        "devices.joint.sampling.rate=1kHz",
        "run.seed=9",
        'devices.joint.onset=["0.6s", "1s"]',
        "costs.act=20us",
    )
    scenario = load(written(tmp_path, GOOD), overrides)
    assert scenario.model.schedule.learn_delay == 250 * ms
    assert scenario.devices["joint"].given()["velocity"] == pytest.approx(1.5707963)
    assert scenario.devices["joint"].given()["sampling"].rate == 1000.0
    assert scenario.devices["joint"].given()["onset"] == (600 * ms, 1000 * ms)
    assert scenario.model.run.seed == 9
    assert assemble(scenario).costs["act"].low == 20_000  # type: ignore[index]  # components are strings


@pytest.mark.parametrize(
    ("order", "sentence"),
    [
        ('["act", "observe", "learn", "choose"]', "this learner learns from the next action"),
        (
            '["choose", "act", "choose", "observe", "learn"]',
            "choose needs an observation newer than the last choice",
        ),
        ('["observe", "choose", "learn"]', "the order has choose but no act"),
        ('["act", "choose", "learn"]', "the order has no observe"),
        ('["observe", "learn"]', "but the order never chooses"),
    ],
)
def test_an_order_that_cannot_work_is_refused(tmp_path: Path, order: str, sentence: str) -> None:
    found = problems(tmp_path, GOOD.replace('preset = "reactive"', f"order = {order}"))
    assert len(found) == 1
    assert sentence in found[0]


def test_a_name_that_is_no_component_is_refused(tmp_path: Path) -> None:
    found = problems(tmp_path, GOOD.replace('preset = "reactive"', 'order = ["observe", "think"]'))
    assert "schedule.order.1: Input should be 'act', 'observe', 'choose' or 'learn'." in found[0]


def test_a_preset_and_an_order_exclude_each_other(tmp_path: Path) -> None:
    found = problems(tmp_path, GOOD.replace('preset = "reactive"', 'preset = "reactive"\norder = ["observe"]'))
    assert "give either preset or order" in found[0]


def test_a_device_that_the_task_needs_is_told(tmp_path: Path) -> None:
    found = problems(tmp_path, GOOD.replace("[devices.joint]", "[devices.elbow]"))
    assert "the task needs a device named 'joint'; the scenario has elbow." in found[0]


def test_features_that_do_not_fit_the_state_are_told(tmp_path: Path) -> None:
    class Angle:
        """A task with a continuous state."""

        state = {"angle": plugins}  # noqa: RUF012  # replaced below
        actions = ("left",)

        def __init__(self) -> None:
            from rtagent.specs import Spec

            self.state = {"angle": Spec(low=0.0, high=1.0)}

        def bind(self, devices: object) -> None: ...

    plugins.register("tasks", "angle", Angle)
    found = problems(tmp_path, GOOD.replace('[task]\ntype = "stopping"', '[task]\ntype = "angle"'))
    assert "signal 'angle'" in found[0]
    assert "has no finite number of values" in found[0]


def test_a_resolved_copy_gives_the_same_run(tmp_path: Path) -> None:
    scenario = load(
        SCENARIOS / "stopping.toml", ["run.clock=virtual", "costs.choose={distribution='uniform',high='3ms'}"]
    )
    copy = load(written(tmp_path, tomli_w.dumps(scenario.resolved())))
    assert copy.resolved() == scenario.resolved()
    assert result_of(copy) == result_of(scenario)


def result_of(scenario: Scenario) -> str:
    return json.dumps(clock.run(assemble(scenario).run(), scenario.model.run.clock).as_dict())


@cache
def published_schema() -> jsonschema.Draft202012Validator:
    validator = jsonschema.Draft202012Validator(json_schema())
    validator.check_schema(validator.schema)
    return validator


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_schema_accepts_our_scenarios_and_their_resolved_copies(path: Path) -> None:
    validator = published_schema()
    validator.validate(tomllib.loads(path.read_text()))
    validator.validate(load(path).resolved())


@pytest.mark.parametrize(
    ("old", "new"),
    [("seed = 1", "sed = 1"), ('"50ms"', "50"), ('"100deg/s"', '"1m"'), ("alpha = 0.1", 'alpha = "x"')],
)
def test_the_schema_refuses_what_rtagent_refuses(old: str, new: str) -> None:
    validator = published_schema()
    assert not validator.is_valid(tomllib.loads(GOOD.replace(old, new, 1)))


def test_a_plugin_registered_here_can_be_named(tmp_path: Path) -> None:
    class Cautious(Greedy):
        """A policy of the user's own."""

        def __init__(self, *, patience: int = 3) -> None:
            self.patience = patience

    plugins.register("policies", "cautious", Cautious)
    text = GOOD.replace('type = "greedy"', 'type = "cautious"\npatience = 5')
    scenario = load(written(tmp_path, text))
    assert scenario.parts["policy"].given() == {"patience": 5}
    assert "cautious" in plugins.names("policies")
    with pytest.raises(PluginError, match="no group 'policy'"):
        plugins.register("policy", "x", Cautious)
