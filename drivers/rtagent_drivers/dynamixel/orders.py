"""What is written to a servo to move, hold or release it: stretches of its control table. No I/O, and few imports.

Angles are the servo's own (rad, from the middle of its range), speeds in rad/s.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from rtagent_drivers.dynamixel.control_table import Mode, Model, Register
from rtagent_drivers.dynamixel.exchange import Question, question
from rtagent_drivers.dynamixel.packets import Codec, Request, Span
from rtagent_drivers.dynamixel.values import bounds, pack, speed_to_raw, to_raw

STATE = ("present_position", "present_velocity", "present_load", "present_voltage", "present_temperature")

HOLD_SPEED = 0.5
"""How fast (rad/s) a servo that is to stay goes back to where it was last seen."""


class Order(NamedTuple):
    """Bytes for the control table of one servo, from `address` on."""

    address: int
    data: bytes


def switch(model: Model, *, on: bool) -> Order:
    """Return the order that switches torque on or off."""
    return _order(model, torque_enable=int(on))


def towards(model: Model, angle: float, speed: float) -> Order:
    """Return the order to go to `angle`, no faster than `speed`, which is above 0."""
    name = speed_register(model)
    register, goal = model.registers[name], model.registers["goal_position"]
    most = bounds(register)[1] * register.scale
    return _order(model, **{name: speed_to_raw(register, min(speed, most)), "goal_position": _nearest(goal, angle)})


def speed_register(model: Model) -> str:
    """Return the name of the register that says how fast a servo goes to its goal."""
    return "moving_speed" if model.protocol == 1 else "profile_velocity"


def turning(model: Model, velocity: float) -> Order:
    """Return the order to turn at `velocity`, in mode wheel."""
    return _order(model, goal_velocity=_nearest(model.registers["goal_velocity"], velocity))


def pushing(model: Model, torque: float) -> Order:
    """Return the order to exert `torque`, a fraction of the full one, in mode torque."""
    return _order(model, goal_torque=_nearest(model.registers["goal_torque"], torque))


def stay(model: Model, mode: Mode, angle: float) -> Order:
    """Return the order to stay at `angle`, where the servo is; in mode torque it is to exert none."""
    if mode == "wheel":
        return turning(model, 0.0)
    if mode == "torque":
        return pushing(model, 0.0)
    return towards(model, angle, HOLD_SPEED)


def unwatch(model: Model) -> Order | None:
    """Return the order that clears a Bus Watchdog, which else lets nothing move again; None where there is none."""
    return _order(model, bus_watchdog=0) if "bus_watchdog" in model.registers else None


def _nearest(register: Register, value: float) -> int:
    low, high = bounds(register)
    least, most = (low - register.zero) * register.scale, (high - register.zero) * register.scale
    return to_raw(register, min(max(value, least), most))


def _order(model: Model, **counts: int) -> Order:
    """Return the bytes of registers that stand side by side."""
    registers = sorted(
        ((model.registers[name], raw) for name, raw in counts.items()), key=lambda each: each[0].address
    )
    return Order(registers[0][0].address, b"".join(pack(register, raw) for register, raw in registers))


def sync_writes(codec: Codec, orders: Mapping[int, Order]) -> Iterator[Request]:
    """Yield the requests that give each servo its order: one for all those that are alike."""
    alike: dict[tuple[int, int], dict[int, bytes]] = {}
    for servo, order in orders.items():
        alike.setdefault((order.address, len(order.data)), {})[servo] = order.data
    for (address, _), data in alike.items():
        yield codec.sync_write(address, data)


def state_span(model: Model, servo: int) -> Span:
    """Return the stretch of a servo's control table that holds all that it measures."""
    return _span(servo, [model.registers[name] for name in STATE])


def register_span(model: Model, servo: int, name: str) -> Span:
    """Return where one register of a servo stands."""
    return _span(servo, [model.registers[name]])


def _span(servo: int, registers: Sequence[Register]) -> Span:
    start = min(register.address for register in registers)
    return Span(servo, start, max(register.address + register.size for register in registers) - start)


def reads_in_groups(model: Model) -> bool:
    """Return whether such servos answer a group read: the AX series knows no bulk read."""
    return not model.name.startswith("AX")


def questions(codec: Codec, together: Sequence[Span], singly: Sequence[Span]) -> list[Question]:
    """Return what is asked to read these spans."""
    single = [question(codec, {span.servo: span.length}, codec.read(span)) for span in singly]
    if not together:
        return single
    expected = {span.servo: span.length for span in together}
    return [question(codec, expected, codec.group_read(together)), *single]
