"""Servos that are nothing but tables of bytes, at the other end of a pty, in the test's own event loop."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable, Mapping

from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.packets import Instruction, Request, Status
from rtagent_drivers.dynamixel.settings import find_model
from rtagent_drivers.dynamixel.values import pack

Tamper = Callable[[int, bytes], bytes]


class ScriptedServos:
    """Tables by id, as from the factory. `tamper` may change what a servo answers: b"" where it is silent."""

    def __init__(self, protocol: int, models: Mapping[int, str]) -> None:
        self.codec = codec(protocol)
        self.tables = {servo: _table(name, protocol, servo) for servo, name in models.items()}
        self.tamper: Tamper = lambda servo, answer: answer
        self.heard: list[Request] = []
        self._decoder = self.codec.request_decoder()
        self._master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave

    def __enter__(self) -> ScriptedServos:
        asyncio.get_running_loop().add_reader(self._master, self._read)
        return self

    def __exit__(self, *error: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        if self._master >= 0:
            asyncio.get_running_loop().remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)
            self._master = -1

    def say(self, data: bytes) -> None:
        os.write(self._master, data)

    def _read(self) -> None:
        for request in self._decoder.feed(os.read(self._master, 4096)):
            self.heard.append(request)
            self._write(request)
            answer = self._answer(request)
            if answer:
                self.say(answer)

    def _write(self, request: Request) -> None:
        for write in self.codec.writes(request):
            if write.servo in self.tables:
                self.tables[write.servo][write.address : write.address + len(write.data)] = write.data

    def _answer(self, request: Request) -> bytes:
        answer = b""
        for span in self.codec.spans(request):
            if span.servo not in self.tables:
                break
            data = bytes(self.tables[span.servo][span.address : span.address + span.length])
            said = self.tamper(span.servo, self.codec.status(Status(span.servo, 0, data)))
            if not said:
                break  # those behind it wait for it
            answer += said
        if request.instruction in (Instruction.PING, Instruction.WRITE) and request.servo in self.tables:
            return self.tamper(request.servo, self.codec.status(Status(request.servo, 0)))
        return answer


def _table(name: str, protocol: int, servo: int) -> bytearray:
    model = find_model(name, protocol)
    table = bytearray(max(register.address + register.size for register in model.registers.values()))
    for register in model.registers.values():
        table[register.address : register.address + register.size] = pack(register, register.initial)
    table[model.registers["id"].address] = servo
    return table
