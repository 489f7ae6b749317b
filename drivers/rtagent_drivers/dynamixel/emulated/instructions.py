"""What servos do when a request comes, and what each of them answers.

Sources: https://emanual.robotis.com/docs/en/dxl/protocol1/ and https://emanual.robotis.com/docs/en/dxl/protocol2/
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel.emulated.memory import Refusal
from rtagent_drivers.dynamixel.emulated.servo import Servo
from rtagent_drivers.dynamixel.packets import BROADCAST, Codec, Instruction, Request, Span, Status

FAST = frozenset({Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ})
READS = {
    1: frozenset({Instruction.READ, Instruction.BULK_READ}),
    2: frozenset({Instruction.READ, Instruction.SYNC_READ, Instruction.BULK_READ}) | FAST,
}
GROUP_WRITES = {
    1: frozenset({Instruction.SYNC_WRITE}),
    2: frozenset({Instruction.SYNC_WRITE, Instruction.BULK_WRITE}),
}
RESTARTS = frozenset({Instruction.FACTORY_RESET, Instruction.REBOOT})
"""Answered before they are done."""

CLEARING = b"\x01DXL\x22"
"""What must come with CLEAR."""

KEPT_BY_RESET = {b"\x01": ("id",), b"\x02": ("id", "baud_rate")}
"""What FACTORY_RESET leaves as it is, by its parameter."""

Answer = tuple[Servo, Status]


def perform(time: int, request: Request, hearing: Mapping[int, Servo], codec: Codec) -> Sequence[Answer]:
    """Let the servos that hear a request, by id, do what it asks at `time` (ns); return their answers in order."""
    try:
        if request.instruction in READS[codec.protocol]:
            return _read(time, codec.spans(request), hearing)
        if request.instruction in GROUP_WRITES[codec.protocol]:
            _write_group(time, request, hearing, codec)
            return ()
        return _each(time, request, hearing, codec)
    except SpecError:  # the parameters are not what the instruction takes
        asked = hearing.get(request.servo)
        return [(asked, Status(asked.id, asked.error(Refusal.LENGTH)))] if asked else ()


def _read(time: int, spans: Iterable[Span], hearing: Mapping[int, Servo]) -> Sequence[Answer]:
    """Answer a read. Each servo of a group waits for the one before it: one that is not there ends it."""
    answers = []
    for span in spans:
        servo = hearing.get(span.servo)
        if servo is None or servo.memory["status_return_level"] == 0:
            break
        data = servo.read(time, span.address, span.length)
        refusal = Refusal.RANGE if data is None else None
        answers.append((servo, Status(servo.id, servo.error(refusal), data or b"")))
    return answers


def _write_group(time: int, request: Request, hearing: Mapping[int, Servo], codec: Codec) -> None:
    for write in codec.writes(request):
        if write.servo in hearing:
            hearing[write.servo].write(time, write.address, write.data)


def _each(time: int, request: Request, hearing: Mapping[int, Servo], codec: Codec) -> Sequence[Answer]:
    """Let one servo, or each, do what is asked; who was asked by its own id answers."""
    everybody = request.servo == BROADCAST
    asked = [hearing[number] for number in sorted(hearing) if everybody or number == request.servo]
    if request.instruction == Instruction.PING:
        return [(servo, _introduction(servo)) for servo in asked]
    answers = []
    for servo in asked:
        number, level = servo.id, servo.memory["status_return_level"]
        before = servo.error()
        refusal = _do(time, servo, request, codec)
        if level == 2 and not everybody:
            error = before if request.instruction in RESTARTS else servo.error(refusal)
            answers.append((servo, Status(number, error)))
    return answers


def _introduction(servo: Servo) -> Status:
    """Return the answer to a ping: in protocol 2.0 it tells the model and the firmware."""
    number = servo.memory["model_number"].to_bytes(2, "little")
    firmware = bytes((servo.memory["firmware_version"],))
    return Status(servo.id, servo.error(), number + firmware if servo.model.protocol == 2 else b"")


def _do(time: int, servo: Servo, request: Request, codec: Codec) -> Refusal | None:
    match request.instruction:
        case Instruction.WRITE:
            (write,) = codec.writes(request)
            return servo.write(time, write.address, write.data)
        case Instruction.REG_WRITE:
            (write,) = codec.writes(request)
            return servo.register(write.address, write.data)
        case Instruction.ACTION:
            return servo.act(time)
        case Instruction.FACTORY_RESET:
            servo.factory_reset(time, KEPT_BY_RESET.get(request.parameters, ()))
            return None
        case _:
            return _do_new(time, servo, request)


def _do_new(time: int, servo: Servo, request: Request) -> Refusal | None:
    """Do what only protocol 2.0 has."""
    if servo.model.protocol == 2 and request.instruction == Instruction.REBOOT:
        servo.reboot(time)
        return None
    if servo.model.protocol == 2 and request.instruction == Instruction.CLEAR:
        return None if request.parameters == CLEARING else Refusal.RANGE
    return Refusal.INSTRUCTION
