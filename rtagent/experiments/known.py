"""The experiments that are installed, by their names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

from rtagent import plugins
from rtagent.errors import PluginError, did_you_mean
from rtagent.experiments.experiment import Experiment

GROUP = "experiments"
ALL = "all"
SECTION = re.compile(r"(?:sections?\s|chapter\s|\()(\d+(?:\.\d+)*)", re.IGNORECASE)
BEYOND = (99,)
"""Where an experiment stands that names no section."""


def experiment(name: str) -> Experiment:
    """Return an experiment by its name; raise `PluginError` where there is none, or it cannot be loaded."""
    found: Any = plugins.load(GROUP, name)
    if not isinstance(found, Experiment):
        raise PluginError(f"the plug-in {name!r} of {GROUP} is no Experiment: mend the package that brings it.")
    return found


def in_order(experiments: Iterable[Experiment]) -> list[Experiment]:
    """Return experiments in the order of the thesis."""
    return sorted(experiments, key=lambda each: (_section(each.thesis), each.on_demand))


def _section(thesis: str) -> tuple[int, ...]:
    found = SECTION.search(thesis)
    return tuple(map(int, found[1].split("."))) if found else BEYOND


def chosen(names: Sequence[str]) -> list[Experiment]:
    """Return experiments by their names, each once, in order; `all` are those that are not on demand only."""
    known = plugins.names(GROUP)
    for name in names:
        if name != ALL and name not in known:
            raise PluginError(f"there is no experiment {name!r}{did_you_mean(name, [*known, ALL])}")
    found = {name: experiment(name) for name in (known if ALL in names else names)}
    return in_order(each for name, each in found.items() if name in names or not each.on_demand)
