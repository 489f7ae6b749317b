"""The calibration of an arm: a TOML file of its own, each joint's zero, direction and soft limits.

[joints.elbow]
zero = "0.31rad"
direction = -1
low = "-1.2rad"
high = "1.5rad"
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from rtagent.errors import SpecError, UnitError, did_you_mean
from rtagent.units import ANGLE
from rtagent_drivers.dynamixel.settings import Placing

KEYS = [field.name for field in fields(Placing)]


def read_calibration(file: Path) -> Mapping[str, Placing]:
    """Return the placing of each joint that a file knows; raise `SpecError` where it cannot be read."""
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise SpecError(f"{file}: {error.strerror}: make it with `rtagent calibrate`.") from error
    except ValueError as error:
        raise SpecError(
            f"{file} is no TOML ({error}): mend it, or make it anew with `rtagent calibrate`."
        ) from error
    joints = data.get("joints")
    if not isinstance(joints, dict) or data.keys() != {"joints"}:
        raise SpecError(f"{file} is no calibration: it has one table for each joint, such as [joints.elbow].")
    return {name: _placing(f"{file}: {name}", table) for name, table in joints.items()}


def _placing(place: str, table: Any) -> Placing:
    if not isinstance(table, dict):
        raise SpecError(f"{place}: expected a table with {', '.join(KEYS)}.")
    for key in table.keys() - set(KEYS):
        raise SpecError(f"{place}: there is no key {key!r}{did_you_mean(key, KEYS)}")
    direction = table.get("direction", 1)
    if direction not in (1, -1):
        raise SpecError(f"{place}: direction is {direction!r}: give 1 or -1.")
    try:
        angles = {key: float(ANGLE.parse(table[key])) for key in table if key != "direction"}
    except UnitError as error:
        raise SpecError(f"{place}: {error}") from error
    return Placing(direction=direction, **angles)


def check_folder(file: Path) -> None:
    """Raise `SpecError` where a calibration cannot be written to `file`, before a person has made it."""
    if not file.absolute().parent.is_dir():
        raise SpecError(f"{file}: there is no folder {file.parent}: make it first.")


def write_calibration(file: Path, placings: Mapping[str, Placing]) -> None:
    """Write a calibration."""
    import tomli_w

    tables = {
        name: {
            "zero": f"{placing.zero:.4f}rad",
            "direction": placing.direction,
            "low": f"{placing.low:.4f}rad",
            "high": f"{placing.high:.4f}rad",
        }
        for name, placing in placings.items()
    }
    file.write_text(tomli_w.dumps({"joints": tables}), encoding="utf-8")
