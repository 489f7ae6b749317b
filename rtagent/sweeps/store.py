"""What is kept of finished cells: a file of lines, each added in one piece, so that a kill loses none of them."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from rtagent import __version__
from rtagent.errors import SweepError

Cell = Mapping[str, Any]
Row = Mapping[str, Any]

AGAIN = "its cell is measured again."


@dataclass(frozen=True)
class Kept:
    """What was found of a cell, as JSON gives it back, and how long (s) measuring it took."""

    row: Row
    seconds: float


def key_of(measure: Callable[..., object], cell: Cell) -> str:
    """Return the key of a cell: a digest of it, of the name of what measures it, and of rtagent's version."""
    known = [f"{measure.__module__}:{measure.__qualname__}", __version__, cell]
    return hashlib.sha256(plain(known, sort=True).encode()).hexdigest()[:32]


def plain(data: object, *, sort: bool = False) -> str:
    """Return data as JSON, with keys in their order, or sorted; raise `SweepError` where it is not plain."""
    try:
        return json.dumps(data, sort_keys=sort, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise SweepError(f"cells and rows are plain data, for JSON: {error}.") from None


class Store:
    """Finished cells by their keys, in a file or, without a path, in memory alone.

    Each line is a checksum (CRC-32) and an entry as JSON. Lines that are damaged or cut off are told in `damaged`,
    and count for nothing. Raises `SweepError` where the file cannot be used, or another sweep uses it.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.damaged: list[str] = []
        self._kept: dict[str, Kept] = {}
        self._file = -1 if path is None else _open(path)
        if path is not None:
            self._read(path.read_bytes())

    def __enter__(self) -> Store:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        if self._file >= 0:
            os.close(self._file)

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: str) -> Kept | None:
        """Return what is kept under a key."""
        return self._kept.get(key)

    def put(self, key: str, cell: Cell, found: str, seconds: float) -> Kept:
        """Keep what was `found` (JSON) of a cell; it is on the disk when this returns."""
        kept = self._kept[key] = Kept(json.loads(found), seconds)
        if self._file >= 0:
            entry = {"key": key, "seconds": seconds, "cell": cell, "row": kept.row}
            os.write(self._file, _line(plain(entry)))
            os.fsync(self._file)
        return kept

    def _read(self, content: bytes) -> None:
        *lines, rest = content.split(b"\n")
        for number, line in enumerate(lines, start=1):
            self._take(number, line)
        if rest:
            self.damaged.append(f"{self.path}:{len(lines) + 1}: this entry was cut off, and is left out: {AGAIN}")
            os.ftruncate(self._file, len(content) - len(rest))

    def _take(self, number: int, line: bytes) -> None:
        checksum, _, text = line.partition(b" ")
        if line and checksum != _checksum(text):
            self.damaged.append(f"{self.path}:{number}: this entry is damaged: {AGAIN}")
        elif line:
            entry = json.loads(text)
            self._kept[entry["key"]] = Kept(entry["row"], entry["seconds"])


def _open(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
    except OSError as error:
        raise SweepError(f"{path}: nothing can be kept there: {error.strerror}.") from None
    _lock(file, path)
    return file


def _lock(file: int, path: Path) -> None:
    """Keep others from the file until it is closed, where the system can."""
    with contextlib.suppress(ImportError):
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise SweepError(f"{path}: another sweep is writing there: wait for its end, or stop it.") from None


def _line(text: str) -> bytes:
    return b"%s %s\n" % (_checksum(text.encode()), text.encode())


def _checksum(text: bytes) -> bytes:
    return b"%08x" % zlib.crc32(text)
