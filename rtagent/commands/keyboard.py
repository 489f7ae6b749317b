"""The keyboard as a stop: space, s or Esc, where a run with real hardware has a terminal."""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any, TextIO, TypeVar

from rtagent.keys import Key
from rtagent.latch import Latch
from rtagent.terminal import listen

T = TypeVar("T")

STOPS = {"space": "space", "s": "s", "escape": "Esc"}


async def with_keyboard(run: Coroutine[Any, Any, T], latch: Latch, out: TextIO | None) -> T:
    """Await `run` while the keys of the terminal, where there is one to read, can trip `latch`, told on `out`."""

    def hear(key: Key) -> None:
        if key.name in STOPS and not key.control:
            latch.trip("keyboard", STOPS[key.name])

    stop_listening = listen(hear)
    if stop_listening is None:
        return await run
    if out is not None:
        out.write("space, s or Esc: stop\n")
        out.flush()
    try:
        return await run
    finally:
        stop_listening()
