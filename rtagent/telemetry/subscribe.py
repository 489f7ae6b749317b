"""Records of runs as they come: an async iterator over typed records.

async for message in subscribe(streams=("sample", "reaction")):
    print(message.agent, message.record)
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Collection
from typing import Any, NamedTuple

import msgspec

from rtagent.telemetry.connection import Access, open_client
from rtagent.telemetry.keys import DATA, place_of
from rtagent.telemetry.records import STREAMS, Record

DECODERS = {stream: msgspec.json.Decoder(kind) for stream, kind in STREAMS.items()}
LOCAL = Access()
MOST_WAITING = 100_000
"""So many messages wait for a reader that is slower; of others the newest are dropped."""


class Message(NamedTuple):
    """A record with where it comes from; `missed` is how many of its stream are missing before it."""

    agent: str
    run: str
    stream: str
    record: Record
    missed: int


class Reader:
    """Makes messages of what came: each record once, and in order."""

    def __init__(self) -> None:
        self._next: dict[str, int] = {}

    def read(self, key: str, data: bytes) -> Message | None:
        """Return the message of a record, or None where it is known already, or of another version."""
        place, stream = place_of(key), key.rsplit("/", 1)[1]
        if stream not in DECODERS:
            return None
        try:
            record = DECODERS[stream].decode(data)
        except msgspec.DecodeError:  # what others publish ends nobody's watching
            return None
        expected = self._next.get(key, record.sequence)
        if record.sequence < expected:
            return None
        self._next[key] = record.sequence + 1
        return Message(place.agent, place.run_id, stream, record, record.sequence - expected)


async def subscribe(
    agent: str = "*",
    run: str = "*",
    streams: Collection[str] = tuple(STREAMS),
    *,
    access: Access = LOCAL,
    connected: Callable[[], None] | None = None,
) -> AsyncGenerator[Message]:
    """Yield the records of these runs as they come, the newest of each stream first.

    `agent` and `run` are names, or "*" for all; `connected` is called once there is a connection. Raises
    `TelemetryError` where there is none.
    """
    loop = asyncio.get_running_loop()
    waiting: asyncio.Queue[tuple[str, bytes]] = asyncio.Queue(MOST_WAITING)
    reader = Reader()

    def take(key: str, data: bytes) -> None:
        if not waiting.full():
            waiting.put_nowait((key, data))

    def heard(sample: Any) -> None:
        key = str(sample.key_expr)
        if key.rsplit("/", 1)[1] in streams:
            loop.call_soon_threadsafe(take, key, sample.payload.to_bytes())

    session = await asyncio.to_thread(open_client, access)
    try:
        keys = f"{DATA}/{agent}/{run}/*"
        session.declare_subscriber(keys, heard)
        if connected is not None:
            connected()
        session.get(keys, lambda reply: heard(reply.ok) if reply.ok is not None else None)
        while True:
            message = reader.read(*await waiting.get())
            if message is not None:
                yield message
    finally:
        await asyncio.to_thread(session.close)  # a session that is left open would hang the interpreter at its end


__all__ = ["Access", "Message", "subscribe"]
