"""The settings of plug-ins as tables: pydantic models made from their signatures."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Any, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, create_model

from rtagent import plugins


@cache
def settings_model(plugin: plugins.Plugin) -> type[BaseModel]:
    """Return a model of the keyword parameters of `plugin` that a scenario may set."""
    fields: dict[str, Any] = {
        name: (
            Any if parameter.annotation is inspect.Parameter.empty else parameter.annotation,
            ... if parameter.default is inspect.Parameter.empty else parameter.default,
        )
        for name, parameter in plugins.settings(plugin).items()
    }
    config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
    return create_model(f"{plugin.__name__}_settings", __config__=config, **fields)


def keys_at(model: type[BaseModel], loc: Sequence[str | int]) -> list[str]:
    """Return the keys of the table at `loc` within a model."""
    kind: Any = model
    for name in loc:
        kind = _key_types(kind).get(str(name)) or _item_type(kind)
    return list(_key_types(kind))


def _key_types(kind: Any) -> dict[str, Any]:
    for candidate in (kind, *get_args(kind)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return {name: info.annotation for name, info in candidate.model_fields.items()}
        if isinstance(candidate, type) and is_dataclass(candidate):
            hints = get_type_hints(candidate)
            return {item.name: hints[item.name] for item in fields(candidate)}
    return {}


def _item_type(kind: Any) -> Any:
    """Return the type of the values of a dict or the items of a tuple, also where it may be left out."""
    arguments = [argument for argument in get_args(kind) if argument not in (Ellipsis, NoneType)]
    if NoneType in get_args(kind):
        return _item_type(arguments[0])
    return arguments[-1] if arguments else Any
