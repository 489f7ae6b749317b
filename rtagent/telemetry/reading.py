"""Reads recordings: the records in the order in which they were made, typed; also of files that were cut off."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from os import SEEK_END
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import msgspec

from rtagent.telemetry.connection import TelemetryError
from rtagent.telemetry.records import STREAMS, Record, Run

MAGIC = b"\x89MCAP0\r\n"
try:
    import zstandard
    from mcap.exceptions import McapError
    from mcap.records import Channel, Chunk, Footer, Message
    from mcap.stream_reader import StreamReader, breakup_chunk
except ImportError:
    raise TelemetryError("recordings need the package mcap: pip install mcap.") from None

UNREADABLE = (McapError, ValueError, EOFError, struct.error, zstandard.ZstdError)
"""What the libraries raise for what was cut off or damaged."""
DECODERS = {stream: msgspec.json.Decoder(kind) for stream, kind in STREAMS.items()}


class Entry(NamedTuple):
    """A message as it stands in the file: its stream, its number, its time since 1970 in ns, and its JSON."""

    stream: str
    sequence: int
    time: int
    data: bytes

    def record(self) -> Record:
        """Return it as a record; raise `TelemetryError` where it is of another version."""
        try:
            return DECODERS[self.stream].decode(self.data)
        except (KeyError, msgspec.MsgspecError) as error:
            raise TelemetryError(
                f"a record of the stream {self.stream!r} is not as this version knows it: {error}. "
                "Read it with the version that `rtagent info` tells."
            ) from None


class Damage(NamedTuple):
    """What is wrong with a file: chunks that could not be read, and whether its end is missing."""

    chunks: int
    cut: bool


WHOLE = Damage(0, cut=False)


def read(path: str | Path) -> Iterator[tuple[str, Record]]:
    """Yield the streams and records of a recording; raise `TelemetryError` where it is none, or is damaged."""
    scan = Scan(path)
    for entry in scan:
        yield entry.stream, entry.record()
    if scan.damage != WHOLE:
        raise TelemetryError(f"{path} was cut off or damaged: `rtagent recover {path}` saves what is readable.")


def read_run(path: str | Path) -> Run:
    """Return what a recording tells of its run, the newest; raise `TelemetryError` where it tells nothing."""
    runs = [entry for entry in Scan(path) if entry.stream == "run"]
    if not runs:
        raise TelemetryError(f"{path} tells of no run: it was cut off at its very beginning, or is another's.")
    record = runs[-1].record()
    assert isinstance(record, Run)
    return record


class _Bounded:
    """A file that is never asked for more than it holds: for a damaged length memory would be made."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._size = file, size

    def read(self, length: int) -> bytes:
        """Return as many bytes as there still are."""
        return self._file.read(min(length, max(0, self._size - self._file.tell())))


class Scan:
    """The entries of a file, in their order; `damage` tells afterwards what was not found.

    Raises `TelemetryError` where the file cannot be opened or is no MCAP.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self.damage = WHOLE
        self._channels = dict(enumerate(STREAMS, start=1))
        try:
            with self._path.open("rb") as file:
                begins = file.read(len(MAGIC))
        except OSError as error:
            raise TelemetryError(f"{path} cannot be read: {error.strerror}. Give a recording.") from None
        if begins != MAGIC:
            raise TelemetryError(f"{path} is no MCAP file: give what `rtagent run --record` has written.")

    def ends(self) -> bool:
        """Say whether the file has an end: a look at its last bytes."""
        with self._path.open("rb") as file:
            file.seek(-len(MAGIC), SEEK_END)
            return file.read() == MAGIC

    def __iter__(self) -> Iterator[Entry]:
        bad, whole = 0, False
        with self._path.open("rb") as file:
            for part in self._parts(file):
                if part is None:
                    whole = True
                    continue
                try:
                    yield from self._entries(part)
                except UNREADABLE:
                    bad += 1
        self.damage = Damage(bad, cut=not whole)

    def _parts(self, file: IO[bytes]) -> Iterator[Any]:
        """Yield the records of the file, chunks as they are, and None at its end, if it has one."""
        try:
            size = self._path.stat().st_size
            reader = StreamReader(cast("IO[bytes]", _Bounded(file, size)), emit_chunks=True, record_size_limit=size)
            for part in reader.records:
                yield None if isinstance(part, Footer) else part
        except UNREADABLE:
            return

    def _entries(self, part: Any) -> Iterator[Entry]:
        if not isinstance(part, Chunk):
            return  # only chunks are checked by a sum
        for each in breakup_chunk(part, validate_crc=True):
            if isinstance(each, Channel):
                self._channels[each.id] = each.topic
            elif isinstance(each, Message) and each.channel_id in self._channels:
                yield Entry(self._channels[each.channel_id], each.sequence, each.log_time, each.data)
