"""Several registers that are read together: an arm may be read a thousand times a second.

`values.unpack` and `values.to_si` say the same of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct

from rtagent_drivers.dynamixel.control_table import Register

UNSIGNED = {1: "B", 2: "H", 4: "I"}


class Layout:
    """Where registers stand in a block of bytes that begins at the first of them."""

    def __init__(self, registers: Sequence[Register]) -> None:
        ordered = sorted(registers, key=lambda register: register.address)
        self.address = ordered[0].address
        self._struct = Struct("<" + "".join(_codes(ordered)))
        self.length = self._struct.size
        self._scales = [(register.zero, register.scale, _sign(register)) for register in ordered]
        self._places = [ordered.index(register) for register in registers]

    def values(self, data: bytes) -> list[float]:
        """Return what the registers say in their SI units, in the order in which they were given."""
        counts = zip(self._struct.unpack(data), self._scales, strict=True)
        values = [((_signed(raw, sign) if sign else raw) - zero) * scale for raw, (zero, scale, sign) in counts]
        return [values[place] for place in self._places]


def _signed(raw: int, sign: int) -> int:
    magnitude = raw & sign - 1
    return -magnitude if raw & sign else magnitude


def _codes(ordered: Sequence[Register]) -> Sequence[str]:
    codes, end = [], ordered[0].address
    for register in ordered:
        code = UNSIGNED[register.size]
        codes.append("x" * (register.address - end) + (code.lower() if register.encoding == "signed" else code))
        end = register.address + register.size
    return codes


def _sign(register: Register) -> int:
    """Return the bit that is the sign of a register, or 0 where it has none of its own."""
    return 1 << register.bits - 1 if register.encoding == "sign_magnitude" else 0
