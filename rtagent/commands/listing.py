"""`rtagent list`: what is installed, with one line each."""

from __future__ import annotations

import argparse
import sys

from rtagent import plugins
from rtagent.errors import PluginError
from rtagent.schedule import PRESETS


def list_command(arguments: argparse.Namespace) -> int:
    """Print the names of a group with a line each."""
    lines = _schedules() if arguments.group == "schedules" else _plugins(arguments.group)
    width = max((len(name) for name in lines), default=0)
    for name, line in lines.items():
        sys.stdout.write(f"{name:<{width}}  {line}\n")
    return 0


def _schedules() -> dict[str, str]:
    return {name: f"{', '.join(preset.order)}: {preset.line}" for name, preset in PRESETS.items()}


def _plugins(group: str) -> dict[str, str]:
    return {name: _line(group, name) for name in plugins.names(group)}


def _line(group: str, name: str) -> str:
    try:
        return plugins.summary(plugins.load(group, name))
    except PluginError as error:
        return str(error)
