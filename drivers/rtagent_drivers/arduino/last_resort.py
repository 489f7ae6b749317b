"""A board made safe by a process that has no event loop: a second way to its port, which blocks.

It imports little, so that it is there at once. It says so again and again until the board confirms; the board
itself makes its servos safe when it hears nothing any more.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
from collections.abc import Mapping, Sequence
from time import monotonic
from typing import Any

from rtagent_drivers.arduino import frames
from rtagent_drivers.arduino.messages import Safety, ServoState
from rtagent_drivers.raw_line import open_line, read_some

WITHIN = 2.5
"""Seconds in which it tries: opening the port may have reset the board, which then needs some two to start."""

PATIENCE, PAUSE = 0.03, 0.005
LINE_ERRORS = (OSError, termios.error)


def open_spare(settings: Mapping[str, Any]) -> Spare:
    """Return a second way to the port: `settings` are those of the driver's `last_resort`."""
    return Spare(settings["port"], settings["baud"], legacy=settings["legacy"], holds=settings["stop"] == "hold")


class Spare:
    """A second way to a board's port. A legacy board holds its servos by itself, and can do nothing else."""

    def __init__(self, port: str, baud: int, *, legacy: bool, holds: bool) -> None:
        self._port, self._baud, self._legacy, self._holds = port, baud, legacy, holds
        self._fd = -1
        self._error = ""
        with contextlib.suppress(*LINE_ERRORS):  # it is tried again when it is needed
            self._open()

    def make_safe(self) -> Sequence[str]:
        """Have the board make its servos safe; return a sentence where it does not confirm."""
        if self._legacy:
            return []
        ends = monotonic() + WITHIN
        while monotonic() < ends:
            try:
                self._open()
                if self._attempt():
                    return []
            except LINE_ERRORS as error:
                self._error = f" ({self._port}: {error})"
                self.close()
                select.select([], [], [], PAUSE)
        return [f"the board did not confirm that its servos are safe{self._error}: switch their power off."]

    def close(self) -> None:
        """Let go of the port."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            with contextlib.suppress(OSError):
                os.close(fd)

    def _open(self) -> None:
        if self._fd < 0:
            self._fd = open_line(self._port, self._baud)

    def _attempt(self) -> bool:
        """Say it once, and listen for a while; return whether it was confirmed."""
        decoder, ends = frames.FrameDecoder(), monotonic() + PATIENCE
        os.write(self._fd, b"\0" + frames.MAKE_SAFE)  # the zero ends what the owner may have left half-sent
        while (left := ends - monotonic()) > 0:
            if not select.select([self._fd], [], [], left)[0]:
                continue
            for message in decoder.feed(read_some(self._fd)):
                if isinstance(message, ServoState) and self._is_safe(message):
                    return True
        return False

    def _is_safe(self, state: ServoState) -> bool:
        return state.safety != Safety.MOVING and (self._holds or not any(state.pulses))
