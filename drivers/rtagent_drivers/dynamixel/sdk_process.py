"""The process in which the dynamixel-sdk talks to servos: requests come in on a pipe, answers go out on another.

    python -m rtagent_drivers.dynamixel.sdk_process PORT BAUD PROTOCOL

It says one line of JSON first: "" once the port is open, or a sentence. Both pipes then hold packets as on a line.
"""

from __future__ import annotations

import fcntl
import json
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

import dynamixel_sdk as sdk

from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.packets import BROADCAST, Codec, Instruction, Request, Status
from rtagent_drivers.dynamixel.timing import wire
from rtagent_drivers.serial_line import PORT_ERRORS, explained, latency_timer

PATIENCE = 8.0
"""How long (ms) an answer may be late: a bus gives up a little later, and not while the SDK still waits."""

STDIN, STDOUT = 0, 1


def main(arguments: Sequence[str]) -> int:
    """Serve a port until the requests end, or until it goes away; return the exit code."""
    path, baud, protocol = arguments[0], int(arguments[1]), int(arguments[2])
    port = sdk.PortHandler(path)
    refusal = _opened(port, path, baud)
    _say(json.dumps(refusal).encode() + b"\n")
    if refusal:
        return 1
    try:
        serve(port, codec(protocol), PATIENCE + (latency_timer(path) or 0))
    except PORT_ERRORS:
        return 1
    return 0


def serve(port: Any, its: Codec, patience: float) -> None:
    """Have the SDK send what comes in and wait for the answers, `patience` (ms) longer than the wire takes."""
    handler, decoder = sdk.PacketHandler(float(its.protocol)), its.request_decoder()
    while data := os.read(STDIN, 65536):
        for request in decoder.feed(data):
            port.is_using = False
            handler.txPacket(port, _as_list(its, request))
            for status in _answers(handler, port, its, request, patience):
                _say(its.status(status))


def _answers(handler: Any, port: Any, its: Codec, request: Request, patience: float) -> Iterator[Status]:
    """Yield the answers to a request, up to the first that does not come."""
    for servo, length in _expected(its, request).items():
        on_the_wire = wire(its.status_length(length), port.getBaudRate()) / 1e6
        port.setPacketTimeoutMillis(patience + on_the_wire)
        data, result, error = handler.readRx(port, servo, length)
        if result != sdk.COMM_SUCCESS:
            return
        yield Status(servo, error, bytes(data))


def _expected(its: Codec, request: Request) -> dict[int, int]:
    """Return how many bytes each servo will answer, in order."""
    reads = {span.servo: span.length for span in its.spans(request)}
    if reads or request.servo == BROADCAST:
        return reads
    says_more = request.instruction == Instruction.PING and its.protocol == 2
    return {request.servo: 3 if says_more else 0}


def _as_list(its: Codec, request: Request) -> list[int]:
    """Return a request as the SDK takes it: with room for what it fills in itself."""
    parameters = list(request.parameters)
    if its.protocol == 1:
        return [0, 0, request.servo, len(parameters) + 2, request.instruction, *parameters, 0]
    length = len(parameters) + 3
    return [0, 0, 0, 0, request.servo, length & 0xFF, length >> 8, request.instruction, *parameters, 0, 0]


def _opened(port: Any, path: str, baud: int) -> str:
    """Open the port for ourselves alone; return why that cannot be, or nothing."""
    try:
        if not port.setBaudRate(baud):
            return f"the SDK does not know {baud} baud: use another rate, or the driver's own back end."
        fcntl.flock(port.ser.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except PORT_ERRORS as error:
        return str(explained(path, error))
    return ""


def _say(data: bytes) -> None:
    os.write(STDOUT, data)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
