"""What a button hears of, whatever it is."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from rtagent.errors import DisconnectedError


class Hearing(Protocol):
    """What hears of presses."""

    counters: Counter[str]

    def hear(self, pressed: bool, sent_at: int | None = None) -> None:
        """Hear of a press or a release, now; `sent_at` (ns, monotonic) is when it was by its sender's word."""

    def lose(self, error: DisconnectedError) -> None:
        """Hear that nothing more can be heard."""


class Source(Protocol):
    """Where presses come from."""

    async def open(self, hearing: Hearing) -> None:
        """Begin to listen; raise `DisconnectedError`, with what to do, where that cannot be."""

    async def close(self) -> None:
        """Stop; may be called more than once."""


class Viewer:
    """Nothing to listen to: who watches the run presses, by `Button.press`."""

    async def open(self, hearing: Hearing) -> None:
        """Do nothing."""

    async def close(self) -> None:
        """Do nothing."""
