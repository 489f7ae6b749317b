"""The JSON schema of scenario files, for editors: the tables, and the settings of every plug-in installed."""

from __future__ import annotations

from typing import Any

from rtagent import plugins
from rtagent.scenario.load import TYPED_TABLES
from rtagent.scenario.model import InputTable, ScenarioModel
from rtagent.scenario.settings import settings_model

REF = "#/$defs/{model}"


def json_schema() -> dict[str, Any]:
    """Return the schema (draft 2020-12)."""
    schema = ScenarioModel.model_json_schema(ref_template=REF)
    definitions = schema["$defs"]
    devices = {key: each for key, each in definitions["DeviceTable"]["properties"].items() if key != "driver"}
    schema["properties"]["devices"]["additionalProperties"] = _one_of("drivers", "driver", devices, definitions)
    own = {"features": {"input": {"$ref": REF.format(model=InputTable.__name__)}}}
    for table, group in TYPED_TABLES.items():
        schema["properties"][table] = _one_of(group, "type", own.get(table, {}), definitions)
    schema["properties"]["horde"] = _horde_table(schema["properties"]["features"], definitions)
    for unused in ("DeviceTable", "FeaturesTable", "HordeTable", "TypedTable"):
        definitions.pop(unused, None)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "rtagent scenario"
    return schema


def _one_of(group: str, name_key: str, properties: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    return {
        "oneOf": [_plugin_table(group, name, name_key, properties, definitions) for name in plugins.names(group)]
    }


def _horde_table(features: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    return _settings_table("learners", "horde", {"features": features}, ["features"], definitions)


def _plugin_table(
    group: str, name: str, name_key: str, properties: dict[str, Any], definitions: dict[str, Any]
) -> dict[str, Any]:
    return _settings_table(group, name, {name_key: {"const": name}} | properties, [name_key], definitions)


def _settings_table(
    group: str, name: str, properties: dict[str, Any], required: list[str], definitions: dict[str, Any]
) -> dict[str, Any]:
    """Return a table of the settings of a plug-in, and of further `properties`, some of them `required`."""
    plugin = plugins.load(group, name)
    own = f"{group}.{name}."  # two plug-ins may have settings of one name
    table = settings_model(plugin).model_json_schema(ref_template=REF.replace("{", own + "{"))
    definitions.update({own + key: each for key, each in table.pop("$defs", {}).items()})
    table["title"] = name
    table["description"] = plugins.summary(plugin)
    table["properties"] = properties | table.get("properties", {})
    table["required"] = [*required, *table.get("required", [])]
    return table
