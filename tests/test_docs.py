"""What the documents show works, and what they name is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from parts import ROOT
from test_backlog import bits, counts, experience, learn_interrupted
from test_presets import counted

from rtagent import clock, plugins, register
from rtagent.learn import Learn
from rtagent.scenario import assemble, load
from rtagent.schedule import PRESETS
from rtagent.testing import DeviceContract

CHECKS = [name for name in vars(DeviceContract) if name.startswith("test_")]


def blocks(document: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / document).read_text(), re.DOTALL)


@pytest.mark.parametrize("check", CHECKS)
@pytest.mark.parametrize("clock", ["real", "virtual"])
def test_the_driver_of_the_page_on_drivers_keeps_the_contract(clock: str, check: str) -> None:
    names: dict[str, Any] = {}
    exec(compile(blocks("docs/drivers.md", "python")[0], "drivers.md", "exec"), names)  # noqa: S102  # our own page
    suite = DeviceContract()
    suite.clock = clock  # type: ignore[assignment]  # one of the two names
    suite.make_device = lambda: names["Thermometer"](port="/dev/ttyUSB0", interval=1_000_000)  # type: ignore[method-assign]
    getattr(suite, check)()


def learners_of_the_page() -> dict[str, Any]:
    names: dict[str, Any] = {}
    for block in blocks("docs/learners.md", "python"):
        exec(compile(block, "learners.md", "exec"), names)  # noqa: S102  # our own page
    return names


@pytest.mark.parametrize("name", ["LinearTD", "ManyStepSizes"])
def test_the_learners_of_the_page_on_learners_learn_the_same_wherever_they_are_interrupted(name: str) -> None:
    kind, rng = learners_of_the_page()[name], np.random.default_rng(1)
    transitions = experience(rng, 30, 50, 5)
    straight, interrupted = kind(size=50), kind(size=50)
    deltas = [straight.update(transition) for transition in transitions]
    told = clock.run(learn_interrupted(interrupted, transitions, Learn(slice=2), rng))
    assert bits(told.deltas) == bits(deltas)
    assert bits(interrupted.weights) == bits(straight.weights)
    assert np.abs(straight.weights).max() > 0
    left = counts(told).get("learned_deferred", 0)
    assert (left > 5) == (name == "ManyStepSizes"), "it was left in the middle of updates"


@pytest.mark.parametrize(("name", "preset"), [("LinearTD", "reactive"), ("ManyStepSizes", "interruptible")])
def test_the_learners_of_the_page_predict_in_a_run(name: str, preset: str, tmp_path: Path) -> None:
    register("learners", "of_the_page", learners_of_the_page()[name])
    scenario = (ROOT / "scenarios" / "predict.toml").read_text()
    scenario = scenario[: scenario.index("[learner]")] + '[learner]\ntype = "of_the_page"\n'
    path = tmp_path / "page.toml"
    path.write_text(scenario.replace('type = "signals"', 'type = "signals"\nreward = "arm.hand_load"'))
    rules = [f"learn.slice={PRESETS[preset].learn.slice}ns", "features.prototypes=100", "learner.gamma=0.5"]
    assembly = assemble(load(path, ["run.episode_steps=50", "devices.arm.arm.duration=10s", *rules]))
    result = clock.run(assembly.run(), "virtual")
    assert sum(counted(result).values()) == counted(result)["learned_in_place"] == 50
    assert np.abs(result.agents[0].learner.weights).max() > 0  # type: ignore[union-attr]  # both have weights


@pytest.mark.parametrize("group", ["drivers", "tasks", "features", "learners", "policies"])
def test_every_plugin_and_its_settings_are_on_the_page_on_scenarios(group: str) -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text()
    for name in plugins.names(group):
        plugin = plugins.load(group, name)
        if not plugin.__module__.startswith("rtagent"):
            continue
        assert f"`{name}`" in page, f"{group} {name} is not described"
        for setting in plugins.settings(plugin):
            assert re.search(rf"`{setting}\b|`[^`]*\b{setting}\b[^`]*`", page), f"{name}.{setting} is not described"


def test_links_between_documents_lead_somewhere() -> None:
    for document in [ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\((?!http)([^)#]+)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name} links to {target}"
