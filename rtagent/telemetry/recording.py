"""Recordings: MCAP files of a run's records, written by a thread of their own."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from mcap.writer import Writer

from rtagent.clock import RealClock
from rtagent.telemetry.records import schema_name, schemas
from rtagent.units import second

CLOSE_CHUNK_EVERY = second // 2
"""What was written is readable, whatever happens, once its chunk is closed: within twice this."""
MOST_WAITING = 64 << 20
"""So many bytes may wait for the disk."""
PATIENCE = 2 * second
"""A disk that takes nothing for so long is told of."""


class McapFile:
    """An MCAP file with a channel for each stream; `close_chunk` makes readable what was added."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._writer: Any = Writer(file, chunk_size=4 << 20)
        self._writer.start(profile="rtagent", library="rtagent")
        self._channels = {stream: self._register(stream, data) for stream, data in schemas()}
        self._safe = 0

    def _register(self, stream: str, data: bytes) -> int:
        number = self._writer.register_schema(schema_name(stream), "jsonschema", data)
        channel: int = self._writer.register_channel(stream, "json", number)
        return channel

    def add(self, stream: str, sequence: int, time: int, data: bytes) -> None:
        """Add a record; `time` is since 1970, in ns."""
        self._writer.add_message(self._channels[stream], time, data, time, sequence)

    def close_chunk(self) -> None:
        """End the chunk, and give all to the system."""
        self._writer._Writer__finalize_chunk()  # the library closes them by size alone
        self._file.flush()
        self._safe = self._file.tell()

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()
        self._file.flush()

    def cut(self) -> None:
        """Take back what was written of a chunk that could not be ended."""
        self._file.truncate(self._safe)


def open_new(path: str) -> IO[bytes]:
    """Return a new file to write to; raise OSError where it cannot be made, or is there already."""
    return Path(path).open("xb", buffering=1 << 20)


class Recorder:
    """Writes records to a file, in a thread; `trouble` is told, in a sentence, of what goes wrong.

    Raises OSError where the file cannot be made. `not_recorded` counts what the file lacks.
    """

    def __init__(self, path: str, trouble: Callable[[str], None]) -> None:
        self.path, self._trouble = path, trouble
        self._file = open_new(path)
        self.not_recorded = 0
        self._waiting = self._written = 0
        self._moved = RealClock.now()
        self._failed = self._told = False
        self._queue: queue.SimpleQueue[tuple[str, int, int, bytes] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="recorder", daemon=True)
        self._thread.start()

    def add(self, stream: str, sequence: int, time: int, data: bytes) -> None:
        """Have a record written; it is left out where too many wait already."""
        if self._failed or self._waiting - self._written > MOST_WAITING:
            self.not_recorded += 1
            return
        self._waiting += len(data)
        self._queue.put((stream, sequence, time, data))

    def look(self) -> None:
        """See whether the disk takes what waits for it."""
        stalled = self._waiting > self._written and RealClock.now() - self._moved > PATIENCE
        if stalled and not self._told and not self._failed:
            self._told = True
            self._trouble(
                f"the recording {self.path} has not moved for {PATIENCE / second:g} s: its disk takes nothing. "
                "The run goes on; what cannot wait is counted."
            )

    def close(self, timeout: float) -> bool:
        """End the file; say whether that was done within `timeout` (s)."""
        self._queue.put(None)
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _write(self) -> None:
        try:
            self._write_all(McapFile(self._file))
        except OSError as error:
            self._failed = True
            self._trouble(
                f"the recording {self.path} ended: {error.strerror}. The run goes on. Make room on the disk; "
                f"`rtagent recover {self.path}` makes what was written complete."
            )
        finally:
            with contextlib.suppress(OSError):
                self._file.close()

    def _write_all(self, file: McapFile) -> None:
        try:
            self._write_chunks(file)
            file.finish()
        except OSError:
            with contextlib.suppress(OSError):
                file.cut()
            raise

    def _write_chunks(self, file: McapFile) -> None:
        """Write until the end of the queue."""
        chunk_ends = RealClock.now()  # the first tells of the run, and what every other is to be read by
        while True:
            entry = self._next(chunk_ends)
            if entry is None:
                return
            if entry:
                file.add(*entry)
                self._written += len(entry[-1])
            self._moved = RealClock.now()
            if self._moved >= chunk_ends:
                file.close_chunk()
                chunk_ends = self._moved + CLOSE_CHUNK_EVERY

    def _next(self, until: int) -> Any:
        """Return the next entry; () where none came `until` then (ns)."""
        try:
            return self._queue.get(timeout=max(0, until - RealClock.now()) / second)
        except queue.Empty:
            return ()
