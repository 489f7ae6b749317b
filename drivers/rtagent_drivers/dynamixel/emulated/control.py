"""What an emulator is told while it runs: one JSON object a line."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

from rtagent.errors import SpecError
from rtagent.units import ANGLE
from rtagent_drivers.dynamixel.emulated.bus import EmulatedBus
from rtagent_drivers.dynamixel.emulated.faults import Fault
from rtagent_drivers.dynamixel.emulated.robots import Joint

USAGE = """\
{"do": "fault", "kind": "silent", "servo": 3, "duration": "2s"}   a fault, from now on (see --fault)
{"do": "mend", "kind": "silent", "servo": 3}                      its end; kind "all" and servo 0 if left out
{"do": "move", "joint": "elbow", "to": "0.5rad"}                  move a limp joint by hand, and hold it there
{"do": "free", "joint": "elbow"}                                  let it go again
{"do": "tell"}                                                    print the state of every joint, as JSON
"""

Reply = dict[str, Any] | None


def obey(bus: EmulatedBus, now: int, line: str) -> Reply:
    """Do what a line says at `now` (ns); return what is to be printed. Raises `SpecError`."""
    order = _json(line, '{"do": "tell"}')
    if not isinstance(order, dict) or order.get("do") not in ORDERS:
        known = ", ".join(ORDERS)
        raise SpecError(f'{line.strip()!r} says not what to do: give "do", one of {known}.')
    return ORDERS[order.pop("do")](bus, now, order)


def read_fault(text: str) -> Fault:
    """Return a fault from a JSON object; raise `SpecError` with all that is wrong with it."""
    fault: Fault = _parsed(Fault, _json(text, '{"kind": "silent", "servo": 3}'))
    return fault


def read_joints(text: str) -> Sequence[Joint]:
    """Return joints from a JSON array of objects; raise `SpecError` with all that is wrong with it."""
    joints: list[Joint] = _parsed(list[Joint], _json(text, '[{"name": "elbow", "id": 2, "model": "MX-28"}]'))
    return joints


def _json(text: str, example: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        raise SpecError(f"{text.strip()!r} is no JSON: {error}. Write something like {example}.") from None


def _fault(bus: EmulatedBus, now: int, order: Mapping[str, Any]) -> Reply:
    bus.faults.add(_parsed(Fault, order), now)
    return None


def _mend(bus: EmulatedBus, now: int, order: Mapping[str, Any]) -> Reply:
    bus.faults.mend(order.get("kind", "all"), order.get("servo", 0), now)
    return None


def _move(bus: EmulatedBus, now: int, order: Mapping[str, Any]) -> Reply:
    if not bus.servo(order.get("joint", "")).move(now, float(ANGLE.parse(order.get("to")))):
        raise SpecError(f"the joint {order['joint']!r} holds against the hand: switch its torque off first.")
    return None


def _free(bus: EmulatedBus, now: int, order: Mapping[str, Any]) -> Reply:
    bus.servo(order.get("joint", "")).move(now, None)
    return None


def _tell(bus: EmulatedBus, now: int, order: Mapping[str, Any]) -> Reply:
    joints = {}
    for servo in bus.servos:
        torque = bool(servo.memory["torque_enable"] and servo.memory.get("torque_limit", 1))
        joints[servo.joint.name] = {**servo.state(now)._asdict(), "torque": torque}
    return {"time": now, "joints": joints}


ORDERS: Mapping[str, Callable[[EmulatedBus, int, dict[str, Any]], Reply]] = {
    "fault": _fault,
    "mend": _mend,
    "move": _move,
    "free": _free,
    "tell": _tell,
}


def _parsed(kind: Any, given: object) -> Any:
    from pydantic import ValidationError

    try:
        return _adapter(kind).validate_python(given)
    except ValidationError as error:
        problems = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg'].rstrip('.')}" for e in error.errors())
        raise SpecError(f"{given!r} cannot be: {problems}.") from None


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)
