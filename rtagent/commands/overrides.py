"""What the command line sets over a scenario."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rtagent.errors import ScenarioError
from rtagent.scenario.source import Source

OPTIONS = ("clock", "fake", "trials", "episodes", "seed")
"""Options that set the key of their name in the table `run`."""


def overrides(scenario: str, arguments: argparse.Namespace) -> list[str]:
    """Return all of it as texts key=value; raise `ScenarioError` where `--data` finds no recording to set."""
    options = {name: getattr(arguments, name, None) for name in OPTIONS}
    own = [f"run.{name}={value}" for name, value in options.items() if value is not None]
    checkpoint = getattr(arguments, "checkpoint", None)
    if checkpoint is not None:
        own.append(f"checkpoint.file={json.dumps(checkpoint)}")
    files = [] if arguments.data is None else _files(scenario, arguments.data, arguments.set)
    return [*files, *arguments.set, *own]


def _files(scenario: str, data: str, given: Sequence[str]) -> list[str]:
    """Return what makes `data` the file of every recording of a scenario."""
    devices = Source(Path(scenario), given).values.get("devices", {})
    recordings = [
        name
        for name, table in (devices.items() if isinstance(devices, dict) else ())
        if isinstance(table, dict) and table.get("driver") == "recording"
    ]
    if not recordings:
        raise ScenarioError(
            [f'--data {data}: {scenario} has no device with driver = "recording"; scenarios/predict.toml has one.']
        )
    return [f"devices.{name}.file={json.dumps(data)}" for name in recordings]
