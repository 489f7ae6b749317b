"""Plug-ins: drivers, tasks, features, learners and policies by their names.

They come from entry points of installed packages, or from `register`. A plug-in is anything callable whose
keyword-only parameters are its settings; those that the runtime supplies (see `CONTEXT`) are not settings.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from rtagent.errors import PluginError, did_you_mean

GROUPS = (
    "drivers", "tasks", "features", "learners", "policies",
    "emulators", "probes", "calibrations", "experiments", "streams",
)  # fmt: skip
CONTEXT = frozenset({"state", "size", "active", "actions", "policy"})
"""What the runtime supplies: the task's state specs and number of actions, the coder's sizes, the policy."""

Plugin = Callable[..., Any]
_registered: dict[tuple[str, str], Plugin] = {}


def register(group: str, name: str, plugin: Plugin) -> None:
    """Make a plug-in known in this process; `group` is one of `GROUPS`."""
    if group not in GROUPS:
        raise PluginError(f"there is no group {group!r} of plug-ins: use one of {', '.join(GROUPS)}.")
    _registered[group, name] = plugin


def names(group: str) -> list[str]:
    """Return the names of all plug-ins of a group, sorted."""
    own = {name for known, name in _registered if known == group}
    return sorted(own | set(_installed(group)))


def load(group: str, name: str) -> Plugin:
    """Return a plug-in by its name; raise `PluginError` with the nearest names where there is none."""
    if (group, name) in _registered:
        return _registered[group, name]
    if name not in _installed(group):
        raise PluginError(f"there is no plug-in {name!r} among the {group}{did_you_mean(name, names(group))}")
    try:
        plugin: Plugin = _installed(group)[name].load()
    except Exception as error:
        raise PluginError(
            f"the plug-in {name!r} of {group} cannot be imported: {error!r}. "
            f"Reinstall the package that brings it ({_installed(group)[name].value})."
        ) from error
    return plugin


def summary(plugin: Plugin) -> str:
    """Return the first line of what a plug-in says of itself."""
    return (inspect.getdoc(plugin) or "no description").splitlines()[0]


def settings(plugin: Plugin) -> dict[str, inspect.Parameter]:
    """Return the parameters of a plug-in that a scenario may set."""
    parameters = inspect.signature(plugin, eval_str=True).parameters
    return {name: parameter for name, parameter in parameters.items() if name not in CONTEXT}


def build(plugin: Plugin, given: dict[str, Any], **context: Any) -> Any:
    """Make what a plug-in makes, from its settings and from what it asks of the context."""
    wanted = inspect.signature(plugin).parameters
    return plugin(**given, **{name: value for name, value in context.items() if name in wanted})


@cache
def _installed(group: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=f"rtagent.{group}")}
