"""What tells a board where its servos are to be, and goes on telling it: that is its heartbeat."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from rtagent.errors import DisconnectedError
from rtagent.units import ms, second
from rtagent_drivers.arduino import frames
from rtagent_drivers.arduino.link import Link
from rtagent_drivers.arduino.servos import ServoBank
from rtagent_drivers.arduino.settings import Settings

SERVO_FRAME = 20 * ms
"""Servos take a new pulse so often: on its way a servo is told as often where to be."""

BEATS = 4
"""The board is spoken to so often within its heartbeat."""


class Speaker:
    """Speaks to a board that is open; `order` are the pins of its servos, in its own order.

    A board is armed with the first command, and again with the first one after its servos were made safe.
    """

    def __init__(self, settings: Settings, order: Sequence[int], link: Link, now: Callable[[], int]) -> None:
        self._settings, self._link, self._now = settings, link, now
        self._servos = ServoBank(settings.servos, order, legacy=settings.layout.legacy)
        self._beating: asyncio.TimerHandle | None = None
        self.armed = False

    def go(self, goals: Mapping[str, float]) -> Mapping[str, float]:
        """Send servos on their way (rad); return where they go. Raises `DisconnectedError`."""
        now = self._now()
        sent = {name: self._servos.go(name, goal, now) for name, goal in goals.items()}
        if sent:
            self._speak()
        return sent

    def start(self) -> int:
        """Send the servos that have a start there; return when they should have arrived."""
        arrival = self._servos.start(self._now())
        if self._servos.on:
            self._speak()
        return arrival

    def stop(self) -> None:
        """Say nothing more: the servos are, or are to be, safe."""
        self._disarm()
        if self._settings.stop == "hold":
            self._servos.stay(self._now())
        else:
            self._servos.forget()

    def forget(self) -> None:
        """Say nothing more, and know nothing: the board has been reset."""
        self._disarm()
        self._servos.forget()

    @property
    def here(self) -> bytes:
        """What says where the servos are to be now."""
        return self._servos.said(self._now())

    def _disarm(self) -> None:
        self.armed = False
        if self._beating is not None:
            self._beating.cancel()
            self._beating = None

    def _speak(self) -> None:
        arming = b"" if self.armed or self._settings.layout.legacy else frames.ARM
        self._link.write(arming + self.here)
        self._disarm()
        self.armed = True
        wait = SERVO_FRAME if self._servos.moving(self._now()) else self._settings.heartbeat // BEATS
        self._beating = asyncio.get_running_loop().call_later(wait / second, self._beat)

    def _beat(self) -> None:
        """Say it again, which also makes good what was lost."""
        self._beating = None
        try:
            self._speak()
        except DisconnectedError:
            self._disarm()  # whoever reads or acts is told
