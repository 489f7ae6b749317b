"""A board's line: what comes from it, as bytes and as messages."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from rtagent.errors import DisconnectedError
from rtagent.units import second
from rtagent_drivers import serial_line
from rtagent_drivers.arduino.messages import Decoder, Message

KEPT = 8192
"""So many bytes are kept for finding out what a board speaks."""

NATIVE = 1_000_000
"""What native USB is opened with: any rate but 1200 baud, which starts its boot loader."""


class Link:
    """A line to a board. `hear` is called with the messages that come together; before that they are kept."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self._line: serial_line.Line | None = None
        self._news = asyncio.Event()
        self.hear: Callable[[Sequence[Message]], None] = self._keep
        self.lost: DisconnectedError | None = None
        self.when_lost: Callable[[], None] = self._news.set
        self.kept: list[Message] = []
        self.raw = b""

    async def open(self, port: str, baud: int) -> str:
        """Connect; return the path. Raises `DisconnectedError`."""
        self._line = await serial_line.connect(port, baud, self)
        return self._line.path

    async def close(self) -> None:
        """Let go of the port."""
        line, self._line = self._line, None
        if line is not None:
            await line.close()

    def write(self, data: bytes) -> None:
        """Send bytes; raise `DisconnectedError`."""
        if self.lost is not None:
            raise self.lost
        if self._line is None:
            raise DisconnectedError("the board is closed: open it first.")
        self._line.write(data)

    async def news(self, within: int) -> None:
        """Wait until something comes, for `within` (ns) at most; raise `DisconnectedError` if the line is gone."""
        try:
            async with asyncio.timeout(within / second):
                await self._news.wait()
        except TimeoutError:
            pass
        self._news.clear()
        if self.lost is not None:
            raise self.lost

    @property
    def bad(self) -> int:
        """How many frames or lines were damaged."""
        return self._decoder.bad

    def data_received(self, data: bytes, /) -> None:
        """Take bytes as they come."""
        messages = self._decoder.feed(data)
        if self.hear == self._keep:
            self.raw = (self.raw + data)[-KEPT:]
        if messages:
            self.hear(messages)
        self._news.set()

    def connection_lost(self, error: DisconnectedError | None, /) -> None:
        """Hear that the line has gone."""
        self.lost = error or DisconnectedError("the board's line was closed.")
        self.when_lost()

    def _keep(self, messages: Sequence[Message]) -> None:
        self.kept += messages
