"""From a file to a validated scenario: every problem at once, each a sentence with its place."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from rtagent import plugins
from rtagent.errors import PluginError, ScenarioError, did_you_mean
from rtagent.scenario.model import DeviceTable, FeaturesTable, ScenarioModel, TypedTable
from rtagent.scenario.settings import keys_at, settings_model
from rtagent.scenario.source import KeyPath, Source

M = TypeVar("M", bound=BaseModel)

TYPED_TABLES = {"task": "tasks", "features": "features", "learner": "learners", "policy": "policies"}
OWN_KEYS: dict[str, type[BaseModel]] = {"drivers": DeviceTable, "features": FeaturesTable}
"""Tables that have further keys of their own beside the plug-in's settings."""


@dataclass
class Part:
    """A plug-in with its validated settings, and where the scenario names it."""

    name: str
    plugin: plugins.Plugin
    settings: BaseModel
    path: KeyPath

    def given(self) -> dict[str, Any]:
        """Return the settings as the plug-in takes them."""
        return {name: getattr(self.settings, name) for name in type(self.settings).model_fields}

    def resolved(self, table: dict[str, Any]) -> dict[str, Any]:
        """Return its table with every setting, in the plug-in's own order, however they were given."""
        settings = self.settings.model_dump(mode="json", exclude_none=True)
        return {name: value for name, value in table.items() if name not in settings} | settings


@dataclass
class Scenario:
    """A validated scenario: its tables, and its plug-ins with their settings."""

    source: Source
    model: ScenarioModel
    devices: dict[str, Part] = field(default_factory=dict)
    parts: dict[str, Part] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its name, or that of its file."""
        return self.model.name or self.source.path.stem

    def resolved(self) -> dict[str, Any]:
        """Return the scenario with every default written out, as data for TOML; loading it gives it again."""
        data = self.model.model_dump(mode="json", exclude_none=True)
        data["name"] = self.name
        for name, part in self.devices.items():
            data["devices"][name] = part.resolved(data["devices"][name])
        for table, part in self.parts.items():
            data[table] = part.resolved(data[table])
        return data


def load(path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read and validate a scenario; raise `ScenarioError` with all its problems."""
    source = Source(Path(path), overrides)
    problems: list[str] = []
    model = _validated(ScenarioModel, source.values, (), source, problems)
    tables = source.values if model is None else model.model_dump()
    scenario = Scenario(source, model) if model is not None else None
    for group, name_key, table_path, table in _plugin_tables(tables):
        part = _part(group, name_key, table_path, table, source, problems)
        if part is not None and scenario is not None:
            home = scenario.devices if group == "drivers" else scenario.parts
            home[str(table_path[-1])] = part
    if problems or scenario is None:
        raise ScenarioError(sorted(problems, key=_line_of))
    return scenario


def _plugin_tables(values: Mapping[str, Any]) -> Iterator[tuple[str, str, KeyPath, Mapping[str, Any]]]:
    """Yield (group, the key that names the plug-in, path, table) of all that names a plug-in."""
    devices = values.get("devices")
    for name, table in devices.items() if isinstance(devices, dict) else ():
        if isinstance(table, dict):
            yield "drivers", "driver", ("devices", name), table
    for table_name, group in TYPED_TABLES.items():
        table = values.get(table_name)
        if isinstance(table, dict):
            yield group, "type", (table_name,), table


def _part(
    group: str, name_key: str, path: KeyPath, table: Mapping[str, Any], source: Source, problems: list[str]
) -> Part | None:
    name = table.get(name_key)
    if not isinstance(name, str):
        return None  # the model has said so already
    try:
        plugin = plugins.load(group, name)
    except PluginError as error:
        problems.append(f"{source.where((*path, name_key))}: {error}")
        return None
    own = OWN_KEYS.get(group, TypedTable).model_fields
    raw = _raw_table(source.values, path)
    given = {key: value for key, value in raw.items() if key not in own}
    settings = _validated(settings_model(plugin), given, path, source, problems)
    return None if settings is None else Part(name, plugin, settings, path)


def _raw_table(values: Mapping[str, Any], path: KeyPath) -> Mapping[str, Any]:
    for name in path:
        values = values[name]  # type: ignore[index]  # the path was read from these very values
    return values


def _validated(
    model: type[M], values: Mapping[str, Any], path: KeyPath, source: Source, problems: list[str]
) -> M | None:
    try:
        return model.model_validate(values)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            place: KeyPath = path + tuple(detail["loc"])
            problems.append(f"{source.where(place)}: {_sentence(detail, place, model)}")
        return None


def _sentence(detail: Any, place: KeyPath, model: type[BaseModel]) -> str:
    key = ".".join(str(name) for name in place)
    if detail["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        known = keys_at(model, detail["loc"][:-1])
        return f"there is no key {key!r}{did_you_mean(str(place[-1]), known)}"
    if detail["type"] == "missing":
        return f"the key {key!r} is missing: add it."
    message = detail["msg"].removeprefix("Value error, ")
    ended = message if message.endswith((".", "?")) else f"{message}."
    return f"{key}: {ended}" if key else ended


def _line_of(problem: str) -> tuple[bool, int]:
    """Return what sorts problems as they stand in the file, those of the command line last."""
    found = re.search(r":(\d+): ", problem)
    return (problem.startswith("--set"), int(found[1]) if found else 0)
