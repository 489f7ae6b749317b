"""Quantities with units, as scenario files write them: `"50ms"`, `"30Hz"`, `"90deg"`, `"1Mbaud"`.

Inside rtagent times are integer nanoseconds and everything else is a float in SI units (rad, m, s, Hz).
Python code writes `50 * ms`; a scenario file writes `"50ms"`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING, Annotated, Any

from rtagent.errors import UnitError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

us = 1_000
ms = 1_000_000
second = 1_000_000_000

degree = math.pi / 180

LARGEST = 2.0**63
"""Whole quantities (ns, baud) are below this."""

_NUMBER = r"[-+]?(?:[0-9]+(?:_[0-9]+)*(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(\D.*?)?\s*")


@dataclass(frozen=True, eq=False)
class Quantity:
    """One kind of quantity: its units in terms of the one that is used inside, the first being that one."""

    kind: str
    units: Mapping[str, float]
    whole: bool = False

    def parse(self, value: object) -> float | int:
        """Return `value`, a string such as `"50ms"`, in the unit used inside; raise `UnitError`."""
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise UnitError(f"expected {self._expected()}, not {value!r}.")
        if not isinstance(value, str):
            if value != 0:
                raise UnitError(f"{value!r} has no unit: write {self._expected(value)}.")
            return 0 if self.whole else 0.0
        return self._parse_text(value)

    def format(self, value: float | int) -> str:
        """Write `value` so that `parse` returns exactly it again, in the largest unit that reads well."""
        base = next(iter(self.units))
        if not self.whole or value == 0:
            return f"{0 if self.whole else float(value)!r}{base}"
        unit, scale = max(
            ((unit, int(scale)) for unit, scale in self.units.items() if value % int(scale) == 0),
            key=lambda item: item[1],
        )
        return f"{int(value) // scale}{unit}"

    def _parse_text(self, text: str) -> float | int:
        match = _QUANTITY.fullmatch(text)
        if match is None:
            raise UnitError(f"{text!r} is not a number with a unit: write {self._expected()}.")
        number = float(match[1])
        unit = (match[2] or "").replace("μ", "µ")
        if unit not in self.units:
            if unit == "" and number == 0:
                return 0 if self.whole else 0.0
            known = ", ".join(self.units)
            raise UnitError(f"{unit!r} in {text!r} is no unit of {self.kind}: use one of {known}.")
        scaled = number * self.units[unit]
        if not abs(scaled) < (LARGEST if self.whole else math.inf):
            raise UnitError(f"{text!r} is too large.")
        return round(Decimal(match[1]) * int(self.units[unit])) if self.whole else scaled

    def _expected(self, number: object = 50) -> str:
        unit = list(self.units)[min(2, len(self.units) - 1)]
        article = "an" if self.kind[0] in "aeiou" else "a"
        return f'{article} {self.kind} such as "{number}{unit}"'

    def __get_pydantic_core_schema__(self, source: object, handler: Callable[[Any], Any]) -> Any:
        """Tell pydantic how scenario files are read (pydantic is imported only where they are)."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            self.parse,
            serialization=core_schema.plain_serializer_function_ser_schema(self.format),
        )

    def __get_pydantic_json_schema__(self, schema: object, handler: object) -> dict[str, Any]:
        """Describe the written form to editors."""
        greek = [unit.replace("µ", "μ") for unit in self.units if "µ" in unit]  # as keyboards write it
        units = "|".join(re.escape(unit) for unit in [*self.units, *greek])
        pattern = rf"^\s*{_NUMBER}\s*({units})\s*$"
        description = f"A {self.kind}: a number and one of {', '.join(self.units)}."
        return {"anyOf": [{"type": "string", "pattern": pattern}, {"const": 0}], "description": description}


TIME = Quantity(
    "time",
    {"ns": 1, "us": us, "ms": ms, "s": second, "min": 60 * second, "h": 3600 * second, "µs": us},
    whole=True,
)
FREQUENCY = Quantity("frequency", {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6})
ANGLE = Quantity("angle", {"rad": 1.0, "turn": 2 * math.pi, "deg": degree})
ANGULAR_VELOCITY = Quantity("angular velocity", {"rad/s": 1.0, "rpm": 2 * math.pi / 60, "deg/s": degree})
ANGULAR_ACCELERATION = Quantity(
    "angular acceleration", {"rad/s²": 1.0, "deg/s²": degree, "rad/s2": 1.0, "deg/s2": degree}
)
LENGTH = Quantity("length", {"m": 1.0, "mm": 1e-3, "cm": 1e-2})
SPEED = Quantity("speed", {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2})
BAUD = Quantity("baud rate", {"baud": 1, "kbaud": 1_000, "Mbaud": 1_000_000}, whole=True)

Duration = Annotated[int, TIME]
"""Nanoseconds."""
Frequency = Annotated[float, FREQUENCY]
"""Hertz."""
Angle = Annotated[float, ANGLE]
"""Radians."""
AngularVelocity = Annotated[float, ANGULAR_VELOCITY]
"""Radians a second."""
AngularAcceleration = Annotated[float, ANGULAR_ACCELERATION]
"""Radians a second, each second."""
Length = Annotated[float, LENGTH]
"""Metres."""
Speed = Annotated[float, SPEED]
"""Metres a second."""
Baud = Annotated[int, BAUD]
"""Bits a second on a serial line."""


def seconds(nanoseconds: int) -> float:
    """Return a time in seconds, for people and for results."""
    return nanoseconds / second


def describe(nanoseconds: float) -> str:
    """Write a time with three digits and the unit that suits it: `24.8 ms`."""
    for unit, scale in (("s", second), ("ms", ms), ("µs", us)):
        if abs(nanoseconds) >= scale:
            number = nanoseconds / scale
            return f"{number:.3g} {unit}" if abs(number) < 999.5 else f"{number:.0f} {unit}"
    return f"{nanoseconds:.0f} ns"
