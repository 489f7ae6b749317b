"""An emulated bus: a host's bytes in at one time, the servos' bytes out at others. It does no I/O."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rtagent.errors import SpecError
from rtagent.units import ms
from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.emulated.faults import Fault, Plan
from rtagent_drivers.dynamixel.emulated.instructions import FAST, Answer, perform
from rtagent_drivers.dynamixel.emulated.line import Line
from rtagent_drivers.dynamixel.emulated.robots import Joint
from rtagent_drivers.dynamixel.emulated.servo import Servo
from rtagent_drivers.dynamixel.emulated.supply import Supply
from rtagent_drivers.dynamixel.packets import BROADCAST, Instruction, Request
from rtagent_drivers.dynamixel.protocol2 import combined
from rtagent_drivers.emulation.command import Log

PATIENCE = 20 * ms
"""A packet whose rest does not come within this time is forgotten."""


class EmulatedBus:
    """Servos of one protocol on one line. All times are in ns and must not go back.

    With `timing`, bytes take as long as on a true line, and collide there. `log` takes what happens as mappings:
    time, event, value, and for a servo its id, joint, position and velocity.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        protocol: int,
        now: int,
        *,
        timing: bool = False,
        faults: Sequence[Fault] = (),
        log: Log | None = None,
    ) -> None:
        self._codec, self._decoder = codec(protocol), codec(protocol).request_decoder()
        self._log = log
        self.faults = Plan(tuple(faults), now)
        self._line = Line(self.faults, timing=timing)
        supply = Supply()
        self.servos = [Servo(joint, now, supply.voltage, self._tell) for joint in joints]
        for servo in self.servos:
            supply.feed(servo)
        _check(self.servos, protocol)
        self._heard_at = now
        self._baud = self.servos[0].baud

    def receive(self, now: int, data: bytes, baud: int | None = None) -> None:
        """Take bytes that the host sends from `now` on, at `baud` (None: at what the first servo listens)."""
        self.advance(now)
        self._baud = baud or self.servos[0].baud
        end, data = self._line.carry(now, data, self._baud)
        if now - self._heard_at > PATIENCE:
            self._decoder.reset()
        self._heard_at = now
        for behind, request in self._with_what_is_behind(self._decoder.feed(data)):
            self._take(end - behind, request)

    def due(self) -> int | None:
        """Return when (ns) something happens by itself next: bytes come, a fault begins, a servo lets go."""
        times = [self._line.due(), self.faults.due(), *(servo.due() for servo in self.servos)]
        return min((time for time in times if time is not None), default=None)

    def advance(self, now: int) -> None:
        """Let happen what happens by itself until `now`."""
        for edge in self.faults.advance(now):
            fault = edge.fault
            self._note({"time": edge.time, "event": "fault" if edge.begins else "mended", "value": fault.kind})
            for servo in self.servos:
                if fault.concerns(servo.id):
                    servo.suffer(edge.time, fault.kind, begins=edge.begins)
        for servo in self.servos:
            servo.advance(now)

    def take(self, now: int) -> bytes:
        """Return the bytes that reach the host by `now`, and have not been taken yet."""
        self.advance(now)
        return self._line.deliver(now, self._baud)

    @property
    def unplugged(self) -> bool:
        """Whether the port is not there."""
        return self.faults.of("unplug", 0) is not None

    def servo(self, name: str | int) -> Servo:
        """Return the servo of a joint, by its name or id; raise `SpecError` where there is none."""
        for servo in self.servos:
            if name in (servo.id, servo.joint.name):
                return servo
        names = ", ".join(servo.joint.name for servo in self.servos)
        raise SpecError(f"there is no joint {name!r}: use one of {names}.")

    def _with_what_is_behind(self, requests: Sequence[Request]) -> Iterator[tuple[int, Request]]:
        """Yield requests that came together, each with how long (ns) the others take that stand behind it."""
        take = [self._line.duration(self._codec.request(request), self._baud) for request in requests]
        for number, request in enumerate(requests, start=1):
            yield sum(take[number:]), request

    def _take(self, time: int, request: Request) -> None:
        hearing = [servo for servo in self.servos if servo.hears(time, self._baud)]
        for servo in hearing:
            servo.advance(time)
            servo.heard(time)
        answers = perform(time, request, {servo.id: servo for servo in hearing}, self._codec)
        if request.instruction in FAST:
            self._answer_together(time, answers, len(self._codec.spans(request)))
        else:
            self._answer(time, request, answers)

    def _answer(self, time: int, request: Request, answers: Sequence[Answer]) -> None:
        for servo, status in answers:
            if self._line.is_silent(servo.id):
                return
            data = self._codec.status(status)
            time = self._line.answer(time, servo.return_delay, servo.id, data, self._baud)
        if len(answers) > 1 and request.instruction == Instruction.PING and self._codec.protocol == 1:
            self._line.collide()

    def _answer_together(self, time: int, answers: Sequence[Answer], asked: int) -> None:
        """Answer in one packet, or, where one of those asked does not answer, not at all."""
        if len(answers) == asked and not any(self._line.is_silent(servo.id) for servo, _ in answers):
            data = self._codec.status(combined([status for _, status in answers]))
            self._line.answer(time, answers[0][0].return_delay, BROADCAST, data, self._baud)

    def _tell(self, time: int, servo: Servo, event: str, value: Any) -> None:
        if self._log is not None:
            state = servo.state(time)
            what = {"time": time, "servo": servo.id, "joint": servo.joint.name, "event": event, "value": value}
            self._note({**what, "position": state.position, "velocity": state.velocity})

    def _note(self, what: dict[str, Any]) -> None:
        if self._log is not None:
            self._log(what)


def _check(servos: Sequence[Servo], protocol: int) -> None:
    if not servos:
        raise SpecError("a bus has at least one servo: give joints.")
    for servo in servos:
        if servo.model.protocol != protocol:
            raise SpecError(f"a {servo.model.name} does not speak protocol {protocol}.0: give the other protocol.")
