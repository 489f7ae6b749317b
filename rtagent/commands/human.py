"""`rtagent run FILE --human`: a person plays Experiment 2 on the arm of a scenario."""

from __future__ import annotations

import argparse
import asyncio
import os
import secrets
import sys
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.console import Console

from rtagent import plugins
from rtagent.device import Pressable
from rtagent.errors import ScenarioError
from rtagent.experiments.egg.attempts import Judge
from rtagent.experiments.egg.conditions import REACTIVE_SARSA, SARSA, in_conditions, shuffled
from rtagent.experiments.egg.trial import learned
from rtagent.latch import Latch
from rtagent.play.game import Game
from rtagent.play.key_reader import KeyReader
from rtagent.play.outcome import table, write
from rtagent.result import Result
from rtagent.scenario import Assembly, Scenario, assemble, load
from rtagent.tasks import ArmStopping
from rtagent.telemetry.link import time_of_day

KEY = "b"
LIVE = {
    "egg": ("participant.strategy=live", 'start=["2s","3s"]'),
    "button": ("source=viewer",),
}
"""How the devices that a person can press are told that one does, by their drivers."""

PRACTICE = 5
"""The first of so many parts of the attempts is practice, as ten of fifty are in the thesis."""


class Human:
    """A run that a person plays: `assembly` is what is run, and `instruments` go with it."""

    def __init__(self, assembly: Assembly, stem: Path) -> None:
        task, plan = assembly.task, assembly.plan
        assert isinstance(task, ArmStopping), "it was looked at before"
        control = max(plan.episodes // PRACTICE, 1)
        each = max((plan.episodes - control) // 2, 1)
        conditions = shuffled((SARSA, REACTIVE_SARSA), control, each, plan.seed)
        learners = {name: learned(name, plan.seed) for name in (SARSA, REACTIVE_SARSA)}
        self.assembly, self._blinding = in_conditions(assembly, conditions, learners)
        self._judge, self._stem, self._button = Judge(task, conditions), stem, assembly.devices[task.button]
        self._game: Game | None = None
        self._keys: KeyReader | None = None

    @property
    def instruments(self) -> list[object]:
        """Who leads through the conditions, who judges, and the game itself."""
        return [self._blinding, self._judge, self._game]

    def begin(self, latch: Latch, out: TextIO) -> bool:
        """Tell the person what to do, and wait for them; say whether they begin."""
        assert isinstance(self._button, Pressable), "it was looked at before"
        self._out = out
        self._game = Game(self._judge, self._button.press, KEY, latch, out)
        self._keys = KeyReader(sys.stdin.fileno(), self._game.hear)
        self._game.introduce()
        return self._game.wait()

    async def accompany(self, run: Coroutine[Any, Any, Result]) -> Result:
        """Await a run while the person plays."""
        assert self._game is not None, "it has begun"
        self._game.play_on(asyncio.get_running_loop())
        return await run

    def close(self) -> None:
        """Draw no more, and give the terminal back."""
        if self._game is not None:
            self._game.close()
        if self._keys is not None:
            self._keys.close()

    def tell(self, result: Result) -> None:
        """Reveal the conditions, and write the person's figure."""
        attempts = self._judge.attempts
        console = Console(file=self._out, highlight=False)
        console.print()
        console.print(table(attempts))
        if attempts:
            console.print(f"\n{write(attempts, self._stem)}", soft_wrap=True)

    def as_dict(self) -> dict[str, Any]:
        """Return the attempts as plain data for JSON; times are in s, angles in rad."""
        return {"attempts": [attempt.as_dict() for attempt in self._judge.attempts]}


def prepare(path: str, given: Sequence[str], arguments: argparse.Namespace) -> tuple[Scenario, Human]:
    """Return a scenario as a person plays it; raise `ScenarioError` where none can."""
    _check_terminal()
    stem = _stem(arguments.human or f"egg-{time_of_day()}")
    seed = [] if arguments.seed is not None else [f"run.seed={secrets.randbelow(10**9)}"]
    name, driver = _button_of(load(path, given))
    scenario = load(path, [*seed, *(f"devices.{name}.{setting}" for setting in LIVE.get(driver, ())), *given])
    assembly, button = assemble(scenario), scenario.devices[name]
    assembly.devices[name] = plugins.build(button.plugin, button.given())  # the driver itself, also with --fake
    _check(scenario, assembly)
    return scenario, Human(assembly, stem)


def _button_of(scenario: Scenario) -> tuple[str, str]:
    """Return the device that the person presses, and its driver."""
    task = scenario.parts["task"]
    if task.plugin is not ArmStopping or getattr(task.settings, "obstacle", None) is None:
        raise ScenarioError(["--human is for the task arm_stopping with an obstacle, as in scenarios/egg.toml."])
    name = str(task.given()["emergency"]).partition(".")[0]
    if name not in scenario.devices:
        raise ScenarioError([f"--human: there is no device {name!r}: let task.emergency name a button."])
    return name, scenario.devices[name].name


def _check(scenario: Scenario, assembly: Assembly) -> None:
    """Refuse what no person can press, or frozen agents, who know Emergency alone, cannot play."""
    task, agent = assembly.task, assembly.make_agent(np.random.default_rng(0))
    assert isinstance(task, ArmStopping), "it was looked at before"
    problems = []
    if scenario.model.run.clock == "virtual":
        problems.append('--human: people know no virtual clock: leave run.clock at "real".')
    if scenario.model.checkpoint.file:
        problems.append("--human: a game cannot be gone on with later: leave out --checkpoint.")
    if len(task.state) != 1 or agent.features.size != 2:
        problems.append('--human: the agents know Emergency alone: no task.signals, features.type = "tabular".')
    if not isinstance(assembly.devices[task.button], Pressable):
        problems.append(f"--human: the device {task.button!r} cannot be pressed: let task.emergency name a button.")
    if problems:
        raise ScenarioError(problems)


def _check_terminal() -> None:
    try:
        there = os.isatty(sys.stdin.fileno())
    except (OSError, ValueError, AttributeError):
        there = False
    if not there:
        raise ScenarioError(["--human reads the keys of a terminal: run it in one, in front."])


def _stem(name: str) -> Path:
    """Return where the figure is to be, a path without its ending; raise `ScenarioError` where one is already."""
    stem = Path(name)
    for path in (stem.with_name(f"{stem.name}.png"), stem.with_name(f"{stem.name}.svg")):
        if path.exists():
            raise ScenarioError(
                [f"--human {name}: {path} is there already: give another name, or it would be lost."]
            )
    if not stem.absolute().parent.is_dir():
        raise ScenarioError([f"--human {name}: give a name in a folder that exists."])
    return stem
