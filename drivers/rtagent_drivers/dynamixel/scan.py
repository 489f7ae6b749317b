"""Which servos answer on a line, at which rate and in which protocol, and how they are."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

from rtagent.units import ms, second, us
from rtagent_drivers.dynamixel import faults
from rtagent_drivers.dynamixel.bus import DEFAULT_RETURN_DELAY, Bus
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.models import MODELS, Model, by_number
from rtagent_drivers.dynamixel.packets import BROADCAST, Instruction, Request, Span, Write
from rtagent_drivers.dynamixel.values import pack, unpack
from rtagent_drivers.serial_line import latency_timer

PROTOCOLS = (2, 1)
MANY = 32
"""More ids than these are called together where the protocol knows that."""

TURN = 3 * ms
"""As long, at most, each servo waits for its turn after a call to all (the SDK's own figure)."""

PATIENCE, MOST_PATIENCE, ALL_PATIENCE = 5 * ms, 50 * ms, 2 * second
"""How late an answer may be: the least, the most, and the sum over all ids that bounds it."""

TRIES = 3
REBOOTING = 500 * ms
STATE = ("torque_enable", "torque_limit", "hardware_error")
PING_LENGTH = {1: 0, 2: 3}
COMMON: Mapping[int, Model] = {1: MODELS["MX-28"], 2: MODELS["XL330-M288"]}
"""All servos of a protocol have model number, firmware version and return delay in the same places."""

RETURN_DELAY_COUNT = 2 * us


@dataclass(frozen=True)
class Found:
    """A servo that answered: what it says of itself, its return delay (ns), and what it complains of.

    `torque` is None where that is not known; `shut_down`, it has let go by itself and stays limp.
    """

    servo: int
    protocol: int
    baud: int
    number: int
    firmware: int
    return_delay: int
    torque: bool | None
    shut_down: bool
    complaints: Sequence[str]

    @property
    def models(self) -> Sequence[Model]:
        """The models that call themselves by this number."""
        return by_number(self.number, self.protocol)


async def scan(
    port: str, bauds: Sequence[int], ids: Sequence[int], protocols: Sequence[int] = PROTOCOLS
) -> list[Found]:
    """Return the servos with these ids that answer at `port`, in the order of rates (bit/s), protocols and ids.

    A servo that did not answer may be there all the same: mute, or at another rate. Raises `DisconnectedError`.
    """
    found: list[Found] = []
    for baud in bauds:
        for protocol in protocols:
            async with calling(port, baud, protocol, len(ids)) as bus:
                found += [await look(bus, servo) for servo in await answering(bus, ids)]
    return found


@asynccontextmanager
async def calling(port: str, baud: int, protocol: int, count: int) -> AsyncIterator[Bus]:
    """Open a bus that waits for answers as long as it may, where `count` servos are called."""
    bus = Bus(codec(protocol), port, baud)
    try:
        path = await bus.open()
        patience = min(MOST_PATIENCE, max(PATIENCE, ALL_PATIENCE // max(1, count)))
        bus.patience = patience + (latency_timer(path) or 0) * ms
        yield bus
    finally:
        await bus.close()


async def answering(bus: Bus, ids: Sequence[int]) -> Sequence[int]:
    """Return those of the ids at which a servo answers."""
    length = PING_LENGTH[bus.codec.protocol]
    if bus.codec.protocol == 2 and len(ids) > MANY:
        answered = await _call_all(bus, ids, length)
        if answered is not None:
            return answered
    return [servo for servo in ids if await bus.transact(Request(servo, Instruction.PING), {servo: length})]


async def _call_all(bus: Bus, ids: Sequence[int], length: int) -> Sequence[int] | None:
    """Return who answers a call to all, or None where the answers ran into each other."""
    bus.return_delay = TURN
    answers = await bus.transact(Request(BROADCAST, Instruction.PING), dict.fromkeys(sorted(ids), length))
    bus.return_delay = DEFAULT_RETURN_DELAY
    return None if bus.counters["packets_damaged"] else sorted(answers)


async def look(bus: Bus, servo: int) -> Found:
    """Return what a servo says of itself; its number, firmware or return delay is 0 where it does not say that."""
    protocol = bus.codec.protocol
    told, error = await _read(bus, servo, COMMON[protocol], "model_number", "firmware_version", "return_delay")
    number = told.get("model_number", 0)
    model = next(iter(by_number(number, protocol)), None)
    state, _ = await _read(bus, servo, model, *STATE) if model else ({}, 0)
    torque, limit, hardware_error = (state.get(name) for name in STATE)
    return Found(
        servo,
        protocol,
        bus.baud,
        number,
        told.get("firmware_version", 0),
        round(told.get("return_delay", 0) * RETURN_DELAY_COUNT),
        None if torque is None else bool(torque),
        limit == 0 or (bool(hardware_error) and torque == 0),
        faults.sentences(protocol, error, hardware_error or 0, limit),
    )


async def mend(bus: Bus, found: Found) -> Found:
    """Let a servo recover that has shut down, and set its return delay to 0; return how it is then.

    Nothing moves: it is left limp. One whose torque is on is left as it is.
    """
    if found.shut_down and found.models:
        await _recover(bus, found)
        found = await look(bus, found.servo)
    if found.return_delay > 0 and found.torque is False:
        await _write(bus, found, "return_delay", 0)
        found = await look(bus, found.servo)
    return found


async def _recover(bus: Bus, found: Found) -> None:
    """Clear what a servo latched: by a reboot, or (protocol 1.0) by giving it its torque back while it is off."""
    if found.protocol == 2:
        await bus.transact(Request(found.servo, Instruction.REBOOT), {found.servo: 0})
        await asyncio.sleep(REBOOTING / second)
        return
    await _write(bus, found, "torque_enable", 0)
    told, _ = await _read(bus, found.servo, found.models[0], "torque_enable", "max_torque")
    if told.get("torque_enable") == 0 and "max_torque" in told:  # with torque on it would move
        await _write(bus, found, "torque_limit", told["max_torque"])


async def _read(bus: Bus, servo: int, model: Model, *names: str) -> tuple[dict[str, int], int]:
    """Return the counts in those of the registers that it has and tells, and the errors that came with them."""
    counts: dict[str, int] = {}
    errors = 0
    for name, register in ((name, model.registers[name]) for name in names if name in model.registers):
        request = bus.codec.read(Span(servo, register.address, register.size))
        status = (await bus.transact(request, {servo: register.size}, TRIES - 1)).get(servo)
        if status is not None:
            errors |= status.error
            if len(status.parameters) == register.size:
                counts[name] = unpack(register, status.parameters)
    return counts, errors


async def _write(bus: Bus, found: Found, name: str, count: int) -> None:
    register = found.models[0].registers[name] if found.models else COMMON[found.protocol].registers[name]
    request = bus.codec.write(Write(found.servo, register.address, pack(register, count)))
    await bus.transact(request, {found.servo: 0}, TRIES - 1)
