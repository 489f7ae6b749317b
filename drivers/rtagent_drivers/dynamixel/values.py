"""Between counts in a control table and SI units, and between counts and bytes.

A trap: `moving_speed` 0 (protocol 1.0, joint mode) and `profile_velocity` 0 (2.0) mean as fast as the servo goes.
Send them through `speed_to_raw`.
"""

from __future__ import annotations

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel.control_table import Register

BAUDS_1 = {250: 2_250_000, 251: 2_500_000, 252: 3_000_000}
BAUDS_2 = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)


def to_si(register: Register, raw: int) -> float:
    """Return what `raw` counts are in the register's SI unit."""
    return (raw - register.zero) * register.scale


def to_raw(register: Register, value: float) -> int:
    """Return the nearest count to `value` (in the SI unit); raise `SpecError` for what the register cannot hold."""
    low, high = bounds(register)
    counts = value / register.scale + register.zero
    if not low - 0.5 <= counts <= high + 0.5:
        raise SpecError(
            f"{value:g} is beyond what the register at {register.address} holds: it takes"
            f" {to_si(register, low):g} to {to_si(register, high):g}."
        )
    return min(max(round(counts), low), high)


def speed_to_raw(register: Register, value: float) -> int:
    """Return the count of a speed limit (moving_speed, profile_velocity): at least 1, as 0 would mean none.

    Raises `SpecError` where `value` (rad/s) is not above 0, or more than the register holds.
    """
    if not value > 0:
        raise SpecError(
            f"a speed of {value:g} rad/s cannot be sent: 0 means as fast as it goes; hold the position."
        )
    return max(1, to_raw(register, value))


def bounds(register: Register) -> tuple[int, int]:
    """Return the least and the greatest count that a register can hold."""
    low, high = _held(register)
    return (
        low if register.low is None else max(low, register.low),
        high if register.high is None else min(high, register.high),
    )


def pack(register: Register, raw: int) -> bytes:
    """Return the bytes of a count; raise `SpecError` where they cannot hold it."""
    low, high = _held(register)
    if not low <= raw <= high:
        raise SpecError(f"{raw} does not fit the register at {register.address}: it holds {low} to {high}.")
    if register.encoding == "sign_magnitude" and raw < 0:
        raw = 1 << register.bits - 1 | -raw
    return raw.to_bytes(register.size, "little", signed=raw < 0)


def unpack(register: Register, data: bytes, offset: int = 0) -> int:
    """Return the count in `data` at `offset`; raise `SpecError` where the data ends before."""
    end = offset + register.size
    if len(data) < end:
        raise SpecError(f"{len(data)} bytes end before the register that stands at {offset} to {end}.")
    raw = int.from_bytes(data[offset:end], "little", signed=register.encoding == "signed")
    if register.encoding == "sign_magnitude":
        sign = 1 << register.bits - 1
        return -(raw & sign - 1) if raw & sign else raw & sign - 1
    return raw


def baud_rate(protocol: int, raw: int) -> int:
    """Return the bit/s that a count of the register baud_rate means; raise `SpecError` where it means none."""
    if protocol == 1 and 0 <= raw <= 254:
        return BAUDS_1.get(raw) or 2_000_000 // (raw + 1)
    if protocol == 2 and 0 <= raw < len(BAUDS_2):
        return BAUDS_2[raw]
    raise SpecError(f"{raw} means no baud rate in protocol {protocol}.")


def _held(register: Register) -> tuple[int, int]:
    bits = 8 * register.size
    if register.encoding == "unsigned":
        return 0, (1 << bits) - 1
    if register.encoding == "signed":
        return -(1 << bits - 1), (1 << bits - 1) - 1
    most = (1 << register.bits - 1) - 1
    return -most, most
