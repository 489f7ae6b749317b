"""A servo's control table as bytes, with its rules of access."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np

from rtagent.saving import Saved
from rtagent_drivers.dynamixel import values
from rtagent_drivers.dynamixel.control_table import Model, Register


class Refusal(Enum):
    """Why a servo does not do what it is asked: its bit among the errors of protocol 1.0, its number in 2.0."""

    INSTRUCTION = 0x40, 2
    CHECKSUM = 0x10, 3
    RANGE = 0x08, 4
    LENGTH = 0x08, 5
    LIMIT = 0x02, 6
    ACCESS = 0x08, 7


class Memory:
    """The control table of one servo; values are the registers' own counts."""

    def __init__(self, model: Model) -> None:
        self._registers = model.registers
        self._bytes = bytearray(max(register.address + register.size for register in model.registers.values()))
        for name, register in self._registers.items():
            self[name] = register.initial

    def __contains__(self, name: str) -> bool:
        return name in self._registers

    def __getitem__(self, name: str) -> int:
        register = self._registers[name]
        return _count(register, self._bytes)

    def __setitem__(self, name: str, count: int) -> None:
        register = self._registers[name]
        self._put(register.address, values.pack(register, count))

    def get(self, name: str, default: int = 0) -> int:
        """Return a register's value, or `default` where this model has none of that name."""
        return self[name] if name in self._registers else default

    def si(self, name: str, default: float = 0.0) -> float:
        """Return a register's value in SI units, or `default` where this model has none of that name."""
        return values.to_si(self._registers[name], self[name]) if name in self._registers else default

    def set_si(self, name: str, value: float) -> None:
        """Set a register, where there is one of that name, to the nearest count that it can hold."""
        if name in self._registers:
            register = self._registers[name]
            self._put(register.address, values.pack(register, _nearest(register, value)))

    def reset(self, *, eeprom: bool, keep: Sequence[str] = ()) -> None:
        """Set registers to what they are from the factory: those kept without power too, where `eeprom`."""
        for name, register in self._registers.items():
            if (eeprom or not register.eeprom) and name not in keep:
                self[name] = register.initial

    def read(self, address: int, length: int) -> bytes | None:
        """Return a stretch of it, or None where it is not that long."""
        return bytes(self._bytes[address : address + length]) if address + length <= len(self._bytes) else None

    def save(self) -> Saved:
        """Return all of it."""
        return {"bytes": np.frombuffer(bytes(self._bytes), np.uint8)}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self._bytes[:] = saved["bytes"].tobytes()

    def refuses(self, address: int, data: bytes, *, locked: bool) -> Refusal | None:
        """Return why `data` cannot be written, or None; `locked` protects what is kept without power."""
        if not data or address + len(data) > len(self._bytes):
            return Refusal.RANGE
        touched = self.touched(address, len(data))
        if any(not register.writable or (locked and register.eeprom) for register in touched.values()):
            return Refusal.ACCESS
        wanted = bytearray(self._bytes)
        wanted[address : address + len(data)] = data
        taken = {register.address for register in touched.values() if _takes(register, wanted)}
        return None if taken == {register.address for register in touched.values()} else Refusal.RANGE

    def write(self, address: int, data: bytes) -> None:
        """Write what was not refused."""
        self._put(address, data)

    def touched(self, address: int, length: int) -> dict[str, Register]:
        """Return the registers that lie in a stretch, wholly or in part."""
        end = address + length
        return {n: r for n, r in self._registers.items() if r.address < end and address < r.address + r.size}

    def _put(self, address: int, data: bytes) -> None:
        self._bytes[address : address + len(data)] = data


def _count(register: Register, table: bytearray) -> int:
    return values.unpack(register, bytes(table[register.address : register.address + register.size]))


def _takes(register: Register, table: bytearray) -> bool:
    count = _count(register, table)
    return (register.low is None or count >= register.low) and (register.high is None or count <= register.high)


def _nearest(register: Register, value: float) -> int:
    """Return the count nearest to `value` (SI) that the register's bytes can hold."""
    least, most = values.bounds(register)
    return min(max(round(value / register.scale) + register.zero, least), most)
