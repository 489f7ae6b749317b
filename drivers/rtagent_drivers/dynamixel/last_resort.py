"""The arm made safe by a process that has no event loop: a second way to its port, which blocks.

It imports little, so that it is there at once, and owns a file of its own beside that of the port's owner, which
may be dead or stopped. It writes through whatever is on the line, again and again, until the servos confirm.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any, Literal

from rtagent_drivers.dynamixel.codecs import codec
from rtagent_drivers.dynamixel.control_table import Mode, Model
from rtagent_drivers.dynamixel.exchange import Exchange, Question
from rtagent_drivers.dynamixel.models import by_name
from rtagent_drivers.dynamixel.orders import (
    STATE,
    Order,
    questions,
    reads_in_groups,
    state_span,
    stay,
    switch,
    sync_writes,
    unwatch,
)
from rtagent_drivers.dynamixel.packets import Request, Span, Status
from rtagent_drivers.dynamixel.timing import transaction
from rtagent_drivers.dynamixel.values import to_si, unpack
from rtagent_drivers.raw_line import open_line, read_some

LINE_ERRORS = (OSError, termios.error)
WITHIN = 0.9
"""Seconds in which it tries to make everything safe."""

PATIENCE = 0.02
"""Seconds for which it waits for answers, beyond what they take by the wire."""

PAUSE = 0.005
"""Seconds between one attempt and the next."""

LONGEST_RETURN_DELAY = 508_000


@dataclass(frozen=True, eq=False)
class Servo:
    """A servo to be made safe."""

    id: int
    joint: str
    model: Model
    mode: Mode


def open_spare(settings: Mapping[str, Any]) -> Spare:
    """Return a second way to the port: `settings` are those of the driver's `last_resort`."""
    servos = [Servo(number, joint, by_name(model), mode) for number, joint, model, mode in settings["servos"]]
    return Spare(settings["port"], settings["baud"], settings["protocol"], settings["stop"], servos)


class Spare:
    """A second way to the port of an arm. On a stop policy of going home it holds: it does not move anything."""

    def __init__(
        self, port: str, baud: int, protocol: int, stop: Literal["hold", "release", "home"], servos: Sequence[Servo]
    ) -> None:
        self._port, self._baud, self._codec, self._servos = port, baud, codec(protocol), servos
        self._holds = stop != "release"
        self._angles: dict[int, float] = {}
        self._on: dict[int, bool] = {}
        self._alone = False
        self._fd = -1
        self._error = ""
        with contextlib.suppress(*LINE_ERRORS):  # it is tried again when it is needed
            self._open()

    def make_safe(self) -> Sequence[str]:
        """Release the servos, or hold those whose torque is on; return a sentence for each that did not confirm."""
        self._angles, self._on, self._alone = {}, {}, False
        ends, left = monotonic() + WITHIN, list(self._servos)
        while left and monotonic() < ends:
            try:
                self._open()
                left = self._attempt(left)
            except LINE_ERRORS as error:
                self._error = f" ({self._port}: {error})"
                self.close()
            self._alone = True  # behind one that is silent the others of a group cannot be heard
            if left:
                select.select([], [], [], PAUSE)
        return [
            f"{servo.joint} (id {servo.id}) did not confirm that it is safe{self._error}: switch its power off."
            for servo in left
        ]

    def close(self) -> None:
        """Let go of the port."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with contextlib.suppress(OSError):
                os.close(fd)

    def _open(self) -> None:
        if self._fd < 0:
            self._fd = open_line(self._port, self._baud)

    def _attempt(self, servos: Sequence[Servo]) -> list[Servo]:
        """Write the safe state of servos; return those that do not say that they have it."""
        if self._holds:
            self._look([servo for servo in servos if servo.id not in self._on], _torque_span, self._hear_torque)
            unseen = [servo for servo in servos if self._on.get(servo.id) and servo.id not in self._angles]
            self._look(unseen, lambda servo: state_span(servo.model, servo.id), self._hear_angle)
        orders = {servo: order for servo in servos if (order := self._order(servo)) is not None}
        spans = {servo: Span(servo.id, order.address, len(order.data)) for servo, order in orders.items()}
        statuses = self._ask(list(self._writes(orders)), spans)
        return [
            servo
            for servo in servos
            if servo not in orders
            or servo.id not in statuses
            or statuses[servo.id].parameters != orders[servo].data
        ]

    def _order(self, servo: Servo) -> Order | None:
        """Return what makes a servo safe, or None where that is not known yet; one that is off stays off."""
        if not self._holds or servo.mode == "torque" or self._on.get(servo.id) is False:
            return switch(servo.model, on=False)
        if servo.id not in self._angles:
            return None
        return stay(servo.model, servo.mode, self._angles[servo.id])

    def _writes(self, orders: Mapping[Servo, Order]) -> Sequence[Request]:
        awake = {servo.id: order for servo in orders if (order := unwatch(servo.model)) is not None}
        safe = {servo.id: order for servo, order in orders.items()}
        return [*sync_writes(self._codec, awake), *sync_writes(self._codec, safe)]

    def _look(
        self, servos: Sequence[Servo], where: Callable[[Servo], Span], hear: Callable[[Servo, bytes], None]
    ) -> None:
        spans = {servo: where(servo) for servo in servos}
        statuses = self._ask([], spans)
        for servo, span in spans.items():
            if servo.id in statuses and len(statuses[servo.id].parameters) == span.length:
                hear(servo, statuses[servo.id].parameters)

    def _hear_torque(self, servo: Servo, data: bytes) -> None:
        self._on[servo.id] = data != b"\0"

    def _hear_angle(self, servo: Servo, data: bytes) -> None:
        position = servo.model.registers["present_position"]
        start = min(servo.model.registers[name].address for name in STATE)
        self._angles[servo.id] = to_si(position, unpack(position, data, position.address - start))

    def _ask(self, writes: Sequence[Request], spans: Mapping[Servo, Span]) -> Mapping[int, Status]:
        """Send requests and read spans; return the answers that came."""
        singly = [span for servo, span in spans.items() if self._alone or not reads_in_groups(servo.model)]
        together = [span for span in spans.values() if span not in singly]
        said = b"".join(map(self._codec.request, writes))
        statuses: dict[int, Status] = {}
        for asked in questions(self._codec, together, singly):
            statuses |= self._exchange(said, asked)
        return statuses

    def _exchange(self, before: bytes, asked: Question) -> Mapping[int, Status]:
        exchange = Exchange(asked, lambda ended: None)
        sent = before + asked.data
        takes = transaction(len(sent), asked.lengths, self._baud, LONGEST_RETURN_DELAY) / 1e9
        termios.tcflush(self._fd, termios.TCIOFLUSH)
        os.write(self._fd, sent)
        decoder, ends = self._codec.status_decoder(), monotonic() + takes + PATIENCE
        while not exchange.over and (left := ends - monotonic()) > 0:
            if select.select([self._fd], [], [], left)[0]:
                for status in decoder.feed(read_some(self._fd)):
                    exchange.take(status)
        return exchange.statuses


def _torque_span(servo: Servo) -> Span:
    register = servo.model.registers["torque_enable"]
    return Span(servo.id, register.address, register.size)
