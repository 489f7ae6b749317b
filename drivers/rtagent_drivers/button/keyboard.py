"""A key of the terminal as a button."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rtagent.errors import DisconnectedError, SpecError
from rtagent.keys import NAMES, Key
from rtagent.units import ms, second
from rtagent_drivers.button.sources import Hearing

STOPS = ("space", "s", "escape")
"""What stops a run with real hardware."""

REPEATS_WITHIN = 150 * ms
"""A key that repeats by itself does so within this time."""


class Keyboard:
    """The key `key` of the terminal that standard input is.

    A terminal that does not tell of releases repeats a key that is held, first after some 500 ms: the key is taken
    to be released when `release_after` (ns) has passed without that, then `REPEATS_WITHIN`. Raises `SpecError` for
    a key that is none, or that stops runs.
    """

    def __init__(self, key: str, release_after: int) -> None:
        if len(key) != 1 and key not in NAMES.values():
            raise SpecError(
                f"there is no key {key!r}: give a character, or one of {', '.join(sorted({*NAMES.values()}))}."
            )
        if key.lower() in STOPS:
            raise SpecError(f"the key {key!r} stops a run: give the button another.")
        self._key, self._release_after = key.lower(), release_after
        self.file: int | None = None
        self._stop_listening: Callable[[], None] | None = None
        self._releasing: asyncio.TimerHandle | None = None
        self._held = False

    async def open(self, hearing: Hearing) -> None:
        """Listen; raise `DisconnectedError` where there is no terminal."""
        from rtagent.terminal import listen  # not everywhere: it needs termios

        self._hearing, self._held = hearing, False
        self._stop_listening = listen(self._hear, self.file, releases=True)
        if self._stop_listening is None:
            raise DisconnectedError(
                "there is no terminal whose keys could be a button: run in one, in front, or give the button "
                'source = "tcp" or "unix".'
            )

    async def close(self) -> None:
        """Stop listening, and give the terminal back as it was."""
        self._keep()
        if self._stop_listening is not None:
            self._stop_listening()
            self._stop_listening = None

    def _hear(self, key: Key) -> None:
        if key.name != self._key or key.control:
            return
        self._keep()
        if key.kind == "release":
            self._set(pressed=False)
            return
        repeats = self._held
        self._set(pressed=True)
        if not key.told:
            wait = REPEATS_WITHIN if repeats else self._release_after
            self._releasing = asyncio.get_running_loop().call_later(wait / second, self._set, False)

    def _set(self, pressed: bool) -> None:
        if pressed != self._held:
            self._held = pressed
            self._hearing.hear(pressed)

    def _keep(self) -> None:
        if self._releasing is not None:
            self._releasing.cancel()
            self._releasing = None
