"""From a file to a validated scenario: every problem at once, each a sentence with its place."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from rtagent import plugins
from rtagent.errors import PluginError, ScenarioError, did_you_mean
from rtagent.scenario.model import DeviceTable, FeaturesTable, HordeTable, ScenarioModel, TypedTable
from rtagent.scenario.settings import keys_at, settings_model
from rtagent.scenario.source import KeyPath, Source

M = TypeVar("M", bound=BaseModel)

TYPED_TABLES = {"task": "tasks", "features": "features", "learner": "learners", "policy": "policies"}
OWN_KEYS: dict[str, type[BaseModel]] = {"drivers": DeviceTable, "features": FeaturesTable}
"""Tables that have further keys of their own beside the plug-in's settings."""


class _PluginTable(NamedTuple):
    """A table of a plug-in's settings; `name_path` is the key that names it, `own` what has its further keys."""

    group: str
    name: Any
    path: KeyPath
    name_path: KeyPath
    own: type[BaseModel]


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
    """A validated scenario: its tables, and its plug-ins with their settings, by the names of their tables."""

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
        for part in (*self.devices.values(), *self.parts.values()):
            home = _table_at(data, part.path[:-1])
            home[part.path[-1]] = part.resolved(home[part.path[-1]])
        return data


def load(path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read and validate a scenario; raise `ScenarioError` with all its problems."""
    source = Source(Path(path), overrides)
    problems: list[str] = []
    model = _validated(ScenarioModel, source.values, (), source, problems)
    tables = source.values if model is None else model.model_dump()
    scenario = Scenario(source, model) if model is not None else None
    for table in _plugin_tables(tables):
        part = _part(table, source, problems)
        if part is None or scenario is None:
            continue
        if table.group == "drivers":
            scenario.devices[str(table.path[-1])] = part
        else:
            scenario.parts[".".join(map(str, table.path))] = part
    if problems or scenario is None:
        raise ScenarioError(sorted(problems, key=_line_of))
    return scenario


def load_devices(path: str | Path, overrides: Sequence[str] = ()) -> tuple[list[Part], list[str]]:
    """Read the devices of a scenario, whatever else is wrong with it; return them, and the problems of the others.

    Raises `ScenarioError` where the file cannot be read.
    """
    source, problems = Source(Path(path), overrides), list[str]()
    tables = [table for table in _plugin_tables(source.values) if table.group == "drivers"]
    parts = [part for table in tables if (part := _part(table, source, problems)) is not None]
    unnamed = [table for table in tables if not isinstance(table.name, str)]
    problems += [f"{source.where(table.path)}: there is no driver: give the device one." for table in unnamed]
    if not tables:
        problems.append(f"{path}: there are no devices: give the scenario that holds them.")
    return parts, problems


def _plugin_tables(values: Mapping[str, Any]) -> Iterator[_PluginTable]:
    """Yield every table of a plug-in's settings; those within another come after it."""
    devices = values.get("devices")
    for name in devices if isinstance(devices, dict) else ():
        yield from _named(values, "drivers", ("devices", name), "driver")
    for table_name, group in TYPED_TABLES.items():
        yield from _named(values, group, (table_name,), "type")
    if isinstance(values.get("horde"), dict):
        yield _PluginTable("learners", "horde", ("horde",), ("horde",), HordeTable)
        yield from _named(values, "features", ("horde", "features"), "type")


def _named(values: Mapping[str, Any], group: str, path: KeyPath, name_key: str) -> Iterator[_PluginTable]:
    """Yield the table at `path`, if it is one, with the plug-in that it names itself."""
    table = _table_at(values, path[:-1]).get(path[-1])
    if isinstance(table, dict):
        yield _PluginTable(group, table.get(name_key), path, (*path, name_key), OWN_KEYS.get(group, TypedTable))


def _part(table: _PluginTable, source: Source, problems: list[str]) -> Part | None:
    if not isinstance(table.name, str):
        return None  # the model has said so already
    try:
        plugin = plugins.load(table.group, table.name)
    except PluginError as error:
        problems.append(f"{source.where(table.name_path)}: {error}")
        return None
    own = table.own.model_fields
    given = {key: value for key, value in _table_at(source.values, table.path).items() if key not in own}
    settings = _validated(settings_model(plugin), given, table.path, source, problems, own)
    return None if settings is None else Part(table.name, plugin, settings, table.path)


def _table_at(values: Any, path: KeyPath) -> Any:
    for name in path:
        values = values[name]
    return values


def _validated(
    model: type[M],
    values: Mapping[str, Any],
    path: KeyPath,
    source: Source,
    problems: list[str],
    own: Collection[str] = (),
) -> M | None:
    """Return `values` as a model, or None after noting what is wrong; the table at `path` also has `own` keys."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        for detail in error.errors(include_url=False):
            place: KeyPath = path + tuple(detail["loc"])
            problems.append(f"{source.where(place)}: {_sentence(detail, place, model, own)}")
        return None


def _sentence(detail: Any, place: KeyPath, model: type[BaseModel], own: Collection[str]) -> str:
    key = ".".join(str(name) for name in place)
    if detail["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        inside = detail["loc"][:-1]
        known = keys_at(model, inside) + ([] if inside else list(own))
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
