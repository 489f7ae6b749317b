"""What a servo complains of, as sentences that tell the user what to do.

Each continues "servo 3 …". Sources: https://emanual.robotis.com/docs/en/dxl/protocol1/, …/protocol2/, and
"Shutdown" and "Hardware Error Status" on the models' pages.
"""

from __future__ import annotations

from collections.abc import Mapping

OVERLOAD = (
    "has been overloaded and lets go of its joint: take the load off, then run rtagent devices --mend, or"
    " switch its power off and on."
)
HOT = "is too hot and lets go of its joint: switch its power off, and let it cool for twenty minutes."
VOLTAGE = "has an input voltage beyond its limits: check the power supply, its cables, and what else it feeds."

ERRORS_1: Mapping[int, str] = {
    0x01: VOLTAGE,
    0x02: "was sent a goal beyond its angle limits: narrow the joint's soft limits, or widen the servo's own.",
    0x04: HOT,
    0x08: "was sent a value out of range: check that its model is the one that the scenario names.",
    0x10: "received a damaged request: check cables and termination, or lower the baud rate.",
    0x20: OVERLOAD,
    0x40: "does not know the instruction: check that its firmware is up to date.",
}
"""By the bit of a status packet's error, protocol 1.0."""

ERRORS_2: Mapping[int, str] = {
    1: "failed to do what it was asked: ask again, and switch its power off and on if that stays so.",
    2: "does not know the instruction: check that its firmware is up to date.",
    3: "received a damaged request: check cables and termination, or lower the baud rate.",
    4: "was sent a value out of range, or its Bus Watchdog has stopped it: open it anew to clear that.",
    5: "was sent too few bytes for a register: check that its model is the one that the scenario names.",
    6: "was sent a value beyond a limit that is set in it: narrow the joint's limits, or widen the servo's own.",
    7: "refuses access: its settings can be written only with torque off, and some registers only be read.",
}
"""By the number in a status packet's error, protocol 2.0."""

HARDWARE: Mapping[int, str] = {
    0x01: VOLTAGE,
    0x04: HOT,
    0x08: "has a broken position sensor: it must not be used until it is repaired.",
    0x10: "has felt an electric shock, or has too little power for its motor: check power supply and cables.",
    0x20: OVERLOAD,
}
"""By the bit of the register hardware_error, protocol 2.0."""

GRAVE_1 = 0x01 | 0x04 | 0x20
ALERT = 0x80
"""The bit of a status packet's error, protocol 2.0, that says: look at hardware_error."""


def sentences(protocol: int, error: int, hardware_error: int = 0, torque_limit: int | None = None) -> list[str]:
    """Return a sentence for each thing that a servo complains of: none where all is well.

    `error` is a status packet's; `hardware_error` that register of protocol 2.0; `torque_limit` that of protocol
    1.0, where it was read: 0 means that an alarm has shut the servo down.
    """
    if protocol == 1:
        found = _bits(ERRORS_1, error)
        shut_down = torque_limit == 0 and OVERLOAD not in found
        return [*found, OVERLOAD] if shut_down else found
    number = error & ~ALERT
    found = [ERRORS_2.get(number, f"reports an unknown error {number}: see its manual.")] if number else []
    hardware = _bits(HARDWARE, hardware_error)
    if error & ALERT and not hardware:
        hardware = ["reports a hardware error: read its register hardware_error, and switch its power off and on."]
    return found + hardware


def is_grave(protocol: int, error: int, hardware_error: int = 0, torque_limit: int | None = None) -> bool:
    """Return whether the servo itself is in trouble (its load, heat, voltage or parts), not just a request."""
    if protocol == 1:
        return bool(error & GRAVE_1) or torque_limit == 0
    return bool(error & ALERT or hardware_error)


def _bits(known: Mapping[int, str], value: int) -> list[str]:
    found = [sentence for bit, sentence in known.items() if value & bit]
    unknown = value & ~sum(known)
    return [*found, f"reports unknown errors {unknown:#04x}: see its manual."] if unknown else found
