"""The kinds of servos that are known, by name and by number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.errors import SpecError, did_you_mean
from rtagent_drivers.dynamixel import tables_1, tables_2
from rtagent_drivers.dynamixel.control_table import Encoding, Mode, Model, Quantity, Register

__all__ = ["MODELS", "Encoding", "Mode", "Model", "Quantity", "Register", "by_name", "by_number"]

MODELS: Mapping[str, Model] = {model.name: model for model in (*tables_1.MODELS, *tables_2.MODELS)}


def by_name(name: str) -> Model:
    """Return the model of that name; raise `SpecError` where none is known."""
    if name not in MODELS:
        raise SpecError(f"no model {name!r} is known{did_you_mean(name, list(MODELS))}")
    return MODELS[name]


def by_number(number: int, protocol: int) -> Sequence[Model]:
    """Return the models that call themselves by that number in that protocol: none where none is known."""
    return [model for model in MODELS.values() if (model.number, model.protocol) == (number, protocol)]
