"""Which servos answer on a line, at which rate and in which protocol, and how they are."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

from rtagent.units import ms, second
from rtagent_drivers.dynamixel import faults
from rtagent_drivers.dynamixel.bus import DEFAULT_RETURN_DELAY, Bus
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.models import MODELS, Model, Register, by_number
from rtagent_drivers.dynamixel.packets import BROADCAST, Instruction, Request, Span, Write
from rtagent_drivers.dynamixel.values import pack, to_si, unpack
from rtagent_drivers.serial_line import latency_timer

PROTOCOLS = (2, 1)
MANY = 32
"""More ids than these are called together where the protocol knows that."""

TURN = 3 * ms
"""As long, at most, each servo waits for its turn after a call to all (the SDK's own figure)."""

PATIENCE, MOST_PATIENCE, ALL_PATIENCE = 5 * ms, 50 * ms, 2 * second
"""How late an answer may be: the least, the most, and the sum over all ids that bounds it."""

PING_LENGTH = {1: 0, 2: 3}
COMMON: Mapping[int, Model] = {1: MODELS["MX-28"], 2: MODELS["XL330-M288"]}
"""All servos of a protocol have model number, firmware version and return delay in the same places."""


@dataclass(frozen=True)
class Found:
    """A servo that answered: what it says of itself, its return delay (ns), and what it complains of.

    `torque` is None where its model is not known.
    """

    servo: int
    protocol: int
    baud: int
    number: int
    firmware: int
    return_delay: int
    torque: bool | None
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
    """Return what a servo says of itself; what it does not say is 0."""
    protocol = bus.codec.protocol
    common = COMMON[protocol].registers
    number, error = await _read(bus, servo, common["model_number"])
    own = next((model.registers for model in by_number(number, protocol)), {})
    states = {name: (await _read(bus, servo, own[name]))[0] for name in OF_INTEREST if name in own}
    delay, _ = await _read(bus, servo, common["return_delay"])
    return Found(
        servo,
        protocol,
        bus.baud,
        number,
        (await _read(bus, servo, common["firmware_version"]))[0],
        round(to_si(common["return_delay"], delay) * second),
        bool(states["torque_enable"]) if own else None,
        faults.sentences(protocol, error, states.get("hardware_error", 0), states.get("torque_limit")),
    )


OF_INTEREST = ("torque_enable", "hardware_error", "torque_limit")


async def _read(bus: Bus, servo: int, register: Register) -> tuple[int, int]:
    """Return the count in a register, and the error that came with it."""
    request = bus.codec.read(Span(servo, register.address, register.size))
    answers = await bus.transact(request, {servo: register.size}, retries=2)
    status = answers.get(servo)
    if status is None or len(status.parameters) < register.size:
        return 0, 0 if status is None else status.error
    return unpack(register, status.parameters), status.error


async def mend(bus: Bus, found: Found) -> bool:
    """Set a servo's return delay to 0; return whether that was done. One with torque on is left as it is."""
    if found.torque is not False:
        return False
    register = COMMON[found.protocol].registers["return_delay"]
    write = bus.codec.write(Write(found.servo, register.address, pack(register, 0)))
    await bus.transact(write, {found.servo: 0}, retries=2)
    return (await _read(bus, found.servo, register))[0] == 0
