"""The experiments that are installed, by their names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rtagent import plugins
from rtagent.errors import PluginError, did_you_mean
from rtagent.experiments.experiment import Experiment

GROUP = "experiments"
ALL = "all"


def experiment(name: str) -> Experiment:
    """Return an experiment by its name; raise `PluginError` where there is none, or it cannot be loaded."""
    found: Any = plugins.load(GROUP, name)
    if not isinstance(found, Experiment):
        raise PluginError(f"the plug-in {name!r} of {GROUP} is no Experiment: mend the package that brings it.")
    return found


def chosen(names: Sequence[str]) -> list[Experiment]:
    """Return experiments by their names, each once; `all` stands for those that are not on demand only."""
    known = plugins.names(GROUP)
    for name in names:
        if name != ALL and name not in known:
            raise PluginError(f"there is no experiment {name!r}{did_you_mean(name, [*known, ALL])}")
    found = {name: experiment(name) for name in (known if ALL in names else names)}
    return [each for name, each in found.items() if name in names or not each.on_demand]
