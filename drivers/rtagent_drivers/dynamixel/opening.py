"""On connecting: who is there, is it what the scenario says, can it keep its rate; then its modes and limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rtagent.errors import DeviceError
from rtagent.units import describe, ms, second
from rtagent_drivers.dynamixel.bus import Bus
from rtagent_drivers.dynamixel.control_table import Model
from rtagent_drivers.dynamixel.faults import is_grave, sentences
from rtagent_drivers.dynamixel.models import by_number
from rtagent_drivers.dynamixel.orders import Order, register_span, switch, sync_writes
from rtagent_drivers.dynamixel.packets import Span, Write
from rtagent_drivers.dynamixel.polling import Roster
from rtagent_drivers.dynamixel.servo import Servo
from rtagent_drivers.dynamixel.timing import transaction
from rtagent_drivers.dynamixel.values import pack, to_raw, to_si, unpack

TRIES = 25
"""A machine that is busy with starting up may let an answer wait for some time."""

RATE_MARGIN = 1.1
WATCHDOG_STEP, LONGEST_WATCHDOG = 20 * ms, 127 * 20 * ms


@dataclass(frozen=True)
class Table:
    """The first part of a servo's control table, with all that is kept without power, as it was read."""

    model: Model
    data: bytes

    def count(self, name: str) -> int:
        """Return the count of a register, or its initial one where it is not in this part."""
        register = self.model.registers[name]
        if register.address + register.size > len(self.data):
            return register.initial
        return unpack(register, self.data, register.address)


async def read_tables(bus: Bus, servos: Sequence[Servo]) -> Mapping[int, Table]:
    """Read the table of every servo; raise `DeviceError` where one does not answer."""
    tables = {servo.id: await _read_table(bus, servo) for servo in servos}
    missing = [f"{servo.axis.name} (id {servo.id})" for servo in servos if tables[servo.id] is None]
    if missing:
        raise DeviceError(
            f"no answer from {', '.join(missing)} at {bus.baud} baud: check power and cables, and which ids and "
            "baud rates there are with `rtagent devices`."
        )
    return {servo: table for servo, table in tables.items() if table is not None}


async def _read_table(bus: Bus, servo: Servo) -> Table | None:
    registers = servo.model.registers
    last = registers["hardware_error" if "hardware_error" in registers else "torque_limit"]
    span = Span(servo.id, 0, last.address + last.size)
    statuses = await bus.transact(bus.codec.read(span), {servo.id: span.length}, TRIES - 1)
    found = statuses.get(servo.id)
    return Table(servo.model, found.parameters) if found and len(found.parameters) == span.length else None


def check_tables(servos: Sequence[Servo], tables: Mapping[int, Table]) -> None:
    """Raise `DeviceError` where a servo is another one than the scenario says, or is in trouble."""
    problems = [sentence for servo in servos for sentence in _problems(servo, tables[servo.id])]
    if problems:
        raise DeviceError(" ".join(problems))


def _problems(servo: Servo, table: Table) -> Iterator[str]:
    number, model = table.count("model_number"), servo.model
    if number != model.number:
        known = " or ".join(each.name for each in by_number(number, model.protocol)) or f"a model {number}"
        yield f"{servo.axis.name} (id {servo.id}) is {known}, not {model.name}: correct its model in the scenario."
        return
    hardware = table.count("hardware_error") if model.protocol == 2 else 0
    limit = table.count("torque_limit") if model.protocol == 1 else None
    if is_grave(model.protocol, 0, hardware, limit):
        said = sentences(model.protocol, 0, hardware, limit)
        yield from (f"{servo.axis.name} (id {servo.id}) {sentence}" for sentence in said)


def return_delay(tables: Mapping[int, Table]) -> int:
    """Return the longest return delay (ns) of all."""
    delays = (
        to_si(table.model.registers["return_delay"], table.count("return_delay")) for table in tables.values()
    )
    return round(max(delays) * second)


def check_rate(bus: Bus, roster: Roster, rate: float, latency: int, path: str) -> Sequence[str]:
    """Return notes on what makes reading slow; raise `DeviceError` where `rate` (Hz) cannot be kept."""
    wire = sum(transaction(len(each.data), each.lengths, bus.baud, bus.return_delay) for each in roster.questions)
    slow = list(_what_is_slow(bus.return_delay, latency, path))
    takes = wire + len(roster.questions) * latency
    if takes > RATE_MARGIN * second / rate:
        raise DeviceError(
            f"a round takes {describe(takes)}, which allows {second / takes:.3g} Hz, not {rate:.3g} Hz: "
            f"lower the rate or raise the baud rate. {' '.join(slow)}".rstrip()
        )
    return slow


def _what_is_slow(delay: int, latency: int, path: str) -> Iterator[str]:
    if delay:
        yield f"Servos wait {describe(delay)} before each answer: give the device return_delay = 0 to change that."
    if latency > ms:
        name = path.rsplit("/", 1)[-1]
        timer = f"/sys/bus/usb-serial/devices/{name}/latency_timer"
        yield f"The adapter holds answers back for {describe(latency)}: run `echo 1 | sudo tee {timer}`."


async def configure(bus: Bus, servo: Servo, table: Table, delay: int | None) -> None:
    """Bring a servo into its mode; what is kept without power is written, with torque off, only if different."""
    wanted = dict(servo.model.modes[servo.axis.joint.mode])
    if delay is not None:
        register = servo.model.registers["return_delay"]
        wanted["return_delay"] = to_raw(register, delay / second)
    kept = {name: raw for name, raw in wanted.items() if servo.model.registers[name].eeprom}
    different = {name: raw for name, raw in kept.items() if table.count(name) != raw}
    if different:
        await bus.send("configure", *sync_writes(bus.codec, {servo.id: switch(servo.model, on=False)}))
        servo.on = False
        for name, raw in different.items():
            await _write(bus, servo, table, name, raw)
        await _confirm(bus, servo, different)
    for name, raw in (wanted.items() - kept.items()) | set(volatile(servo)):
        await _write(bus, servo, table, name, raw)


def volatile(servo: Servo) -> Iterator[tuple[str, int]]:
    """Yield what is set in a servo whenever it is opened: what it may exert, and how fast it speeds up."""
    registers, joint = servo.model.registers, servo.axis.joint
    effort = "torque_limit" if servo.model.protocol == 1 else "goal_pwm"
    if servo.model.protocol == 1 or joint.mode != "torque":
        yield effort, to_raw(registers[effort], joint.max_load)
    for name in ("goal_acceleration", "profile_acceleration"):
        if name in registers:
            most = registers[name].high or 0
            counts = round(joint.max_acceleration / registers[name].scale)
            yield name, min(max(counts, 1), most) if joint.max_acceleration else 0


async def _write(bus: Bus, servo: Servo, table: Table, name: str, raw: int) -> None:
    register = servo.model.registers[name]
    request = bus.codec.write(Write(servo.id, register.address, pack(register, raw)))
    answers = {servo.id: 0} if table.count("status_return_level") == 2 else {}
    statuses = await bus.transact(request, answers, TRIES - 1)
    error = statuses[servo.id].error if servo.id in statuses else 0
    said = sentences(servo.model.protocol, error)
    if said:
        raise DeviceError(f"{servo.axis.name} (id {servo.id}) was to set {name} to {raw}, but {said[0]}")


async def _confirm(bus: Bus, servo: Servo, written: Mapping[str, int]) -> None:
    found = await _read_table(bus, servo)
    for name, raw in written.items():
        if found is None or found.count(name) != raw:
            raise DeviceError(
                f"{servo.axis.name} (id {servo.id}) did not take {name} = {raw}: switch its power off and on."
            )


async def read_register(bus: Bus, servo: Servo, name: str) -> int | None:
    """Return the count of one register, or None where there was no answer."""
    span = register_span(servo.model, servo.id, name)
    statuses = await bus.transact(bus.codec.read(span), {servo.id: span.length}, TRIES - 1)
    found = statuses.get(servo.id)
    if found is None or len(found.parameters) != span.length:
        return None
    return unpack(servo.model.registers[name], found.parameters)


async def set_bus_watchdogs(bus: Bus, servos: Sequence[Servo], after: int) -> None:
    """Have servos stop by themselves when they hear nothing for `after` (ns; 0: never), as far as they can."""
    able = [servo for servo in servos if "bus_watchdog" in servo.model.registers]
    steps = -(-after // WATCHDOG_STEP)
    for counts in dict.fromkeys((0, steps)):  # 0 clears one that has stopped its servo
        orders = {servo.id: _watchdog_order(servo, counts) for servo in able}
        await bus.send(f"watchdog {counts}", *sync_writes(bus.codec, orders))


def _watchdog_order(servo: Servo, counts: int) -> Order:
    register = servo.model.registers["bus_watchdog"]
    return Order(register.address, pack(register, counts))
