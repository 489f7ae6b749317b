"""Runs of scenarios that keep checkpoints, and what is compared of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from parts import SCENARIOS

from rtagent import clock
from rtagent.agent import Agent
from rtagent.checkpoint.file import Checkpoint, read
from rtagent.checkpoint.keeper import Keeper, Rules
from rtagent.clock import ClockName
from rtagent.result import Result
from rtagent.saving import Saved
from rtagent.scenario import assemble, load


class KeepsAll(Keeper):
    """Keeps every checkpoint in a file of its own."""

    def __init__(self, folder: Path, rules: Rules, resumed: Checkpoint | None = None) -> None:
        super().__init__(folder / "agent.ckpt", rules, {}, resumed)
        self.kept: list[Path] = []

    def _keep(self, within_episode: bool) -> None:
        self.path = self.path.with_name(f"{len(list(self.path.parent.iterdir()))}.ckpt")
        self.kept.append(self.path)
        super()._keep(within_episode)

    def checkpoints(self) -> list[Checkpoint]:
        return [read(path) for path in self.kept]


def run_scenario(
    name: str,
    overrides: Sequence[str],
    keeper: Keeper | None = None,
    clock_name: ClockName = "virtual",
    **more: Any,
) -> Result:
    assembly = assemble(load(SCENARIOS / f"{name}.toml", [f"run.clock={clock_name}", *overrides]))
    return clock.run(assembly.run(keeper=keeper, **more), clock_name)


def plain(value: Any) -> Any:
    """Return a saved state so that it compares to the bit."""
    if isinstance(value, np.ndarray | np.generic):
        return type(value).__name__, str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return repr(value)


def learned(agent: Agent) -> Any:
    """Return all that an agent has learned, and what its coder remembers."""
    saved: Saved = agent.save()
    return plain(saved["parts"])


def all_of(result: Result) -> Any:
    """Return all that is told of a run, and all that its agents know."""
    return json.dumps(result.as_dict()), [plain(agent.save()) for agent in result.agents]
