"""The keyboard as a stop: space, s or Esc, where a run with real hardware has a terminal."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import termios
import tty
from collections.abc import Coroutine, Iterator
from typing import Any, TextIO, TypeVar

from rtagent.latch import Latch

T = TypeVar("T")

STOPS = {b" ": "space", b"s": "s", b"S": "s", b"\x1b": "Esc"}


async def with_keyboard(run: Coroutine[Any, Any, T], latch: Latch, out: TextIO | None) -> T:
    """Await `run` while the keys of the terminal, where there is one to read, can trip `latch`, told on `out`."""
    try:
        terminal = sys.stdin.fileno()
        in_front = os.isatty(terminal) and os.tcgetpgrp(terminal) == os.getpgrp()
    except (OSError, ValueError, AttributeError):
        in_front = False
    if not in_front:
        return await run
    if out is not None:
        out.write("space, s or Esc: stop\n")
        out.flush()
    with _keys_at_once(terminal), _listening(terminal, latch):
        return await run


@contextlib.contextmanager
def _keys_at_once(terminal: int) -> Iterator[None]:
    """Have each key arrive as it is pressed, without an echo; give the terminal back as it was."""
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal, termios.TCSANOW)
    try:
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSANOW, before)


@contextlib.contextmanager
def _listening(terminal: int, latch: Latch) -> Iterator[None]:
    loop = asyncio.get_running_loop()

    def hear() -> None:
        pressed = os.read(terminal, 1024)
        if not pressed:
            loop.remove_reader(terminal)  # the terminal is gone
        for key, name in STOPS.items():
            if key in pressed:
                latch.trip("keyboard", name)

    loop.add_reader(terminal, hear)
    try:
        yield
    finally:
        loop.remove_reader(terminal)
