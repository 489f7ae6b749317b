"""Checkpoint files: what was saved, as JSON and plain arrays in a zip archive that is not compressed.

`about.json` names the format and its version, tells of the run, and holds the SHA-256 digest of the rest;
`state.json` is what was saved, in which arrays are told by type and shape; `arrays.bin` has
their bytes, one after the other. Nothing in it is ever executed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import CheckpointError
from rtagent.saving import Saved

FORMAT, VERSION = "rtagent checkpoint", 1
ABOUT, STATE, ARRAYS = "about.json", "state.json", "arrays.bin"

ARRAY = "__array__"
"""The only key of what stands for an array, in the order of their bytes: type and shape (None: a scalar)."""

KINDS = "biuf"
"""Arrays hold truth values, integers or floats."""

PIECE = 1 << 20
"""So many bytes are hashed and written at a time."""


class Checkpoint(NamedTuple):
    """What a file holds: `about` the run that it is of, and what was `saved`."""

    about: Mapping[str, Any]
    saved: Saved


def write(path: Path, about: Mapping[str, Any], saved: Saved) -> None:
    """Write a checkpoint where another may be, which stays whole until this one is; raise `CheckpointError`."""
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("wb") as file:
            _write(file, about, saved)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        raise CheckpointError(f"{path} cannot be written: {error.strerror or error}.") from None
    finally:
        with suppress(OSError):
            new.unlink(missing_ok=True)


def read(path: Path) -> Checkpoint:
    """Read a checkpoint; raise `CheckpointError` where there is none, or it is damaged, or newer than this."""
    try:
        with zipfile.ZipFile(path) as archive:
            about = _about(path, archive)
            state, arrays = _entry(archive, STATE), _entry(archive, ARRAYS)
        if _digest(about, [state, arrays]) != about["digest"]:
            raise CheckpointError(f"{path} is damaged: its digest is not that of its contents. Take an older one.")
        return Checkpoint(about, _unpacked(json.loads(state), _Cursor(arrays)))
    except FileNotFoundError:
        raise CheckpointError(f"there is no checkpoint {path}: run without --resume to begin with one.") from None
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror or error}.") from None
    except (zipfile.BadZipFile, EOFError) as error:
        raise CheckpointError(f"{path} is no checkpoint, or is cut off or damaged: {_said(error)}.") from None
    except (ValueError, TypeError, KeyError, IndexError, RecursionError, OverflowError, zlib.error) as error:
        if isinstance(error, CheckpointError):
            raise
        raise CheckpointError(f"{path} is damaged: {_said(error)}. Take an older one.") from None
    except (
        RuntimeError,
        MemoryError,
    ) as error:  # NotImplementedError is one: zipfile's, for flags that are not ours
        raise CheckpointError(f"{path} is damaged: {_said(error)}. Take an older one.") from None


def _said(error: BaseException) -> str:
    return str(error).rstrip(".") or type(error).__name__


def _about(path: Path, archive: zipfile.ZipFile) -> dict[str, Any]:
    if ABOUT not in archive.namelist():
        raise CheckpointError(f"{path} is a zip archive, but no checkpoint.")
    about = json.loads(_entry(archive, ABOUT))
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise CheckpointError(f"{path} is no checkpoint of rtagent.")
    if about.get("version") != VERSION:
        raise CheckpointError(
            f"{path} has version {about.get('version')} of the format, and this rtagent reads version {VERSION}: "
            "use the rtagent that wrote it."
        )
    return about


def _entry(archive: zipfile.ZipFile, name: str) -> bytes:
    found = archive.getinfo(name)
    if found.compress_type != zipfile.ZIP_STORED or found.compress_size != found.file_size:
        raise CheckpointError(f"{archive.filename} is damaged: {name} is compressed, which none of its kind is.")
    return archive.read(found)


def _write(file: BinaryIO, about: Mapping[str, Any], saved: Saved) -> None:
    arrays: list[NDArray[Any]] = []
    state = json.dumps(packed(saved, arrays)).encode()
    head = {"format": FORMAT, "version": VERSION, **about}
    contents = [_bytes_of(array) for array in arrays]
    head["digest"] = _digest(head, [state, *contents])
    with zipfile.ZipFile(file, "w") as archive:
        _add(archive, STATE, [state])
        _add(archive, ARRAYS, contents)
        _add(archive, ABOUT, [json.dumps(head, indent=2).encode()])


def _add(archive: zipfile.ZipFile, name: str, contents: Iterable[bytes | memoryview]) -> None:
    with archive.open(zipfile.ZipInfo(name), "w", force_zip64=True) as entry:
        for content in contents:
            for piece in _pieces(content):
                entry.write(piece)


def _digest(about: Mapping[str, Any], contents: Iterable[bytes | memoryview]) -> str:
    told = {name: value for name, value in about.items() if name != "digest"}
    digest = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for content in contents:
        for piece in _pieces(content):
            digest.update(piece)
    return digest.hexdigest()


def _pieces(content: bytes | memoryview) -> Iterator[memoryview]:
    view = memoryview(content)
    for first in range(0, len(view), PIECE):
        yield view[first : first + PIECE]


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def _sync_folder(folder: Path) -> None:
    """Have the new name of a file on the disk too, where folders can be opened."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def packed(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return what JSON can hold of a value, its arrays put into a list; raise `CheckpointError` for others."""
    if isinstance(value, Mapping):
        return {_name(name): packed(each, arrays) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [packed(each, arrays) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return _placed(value, arrays)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise CheckpointError(
        f"a checkpoint holds plain arrays, numbers and texts, and no {type(value).__name__}: save it as such."
    )


def _name(name: object) -> str:
    if not isinstance(name, str) or name == ARRAY:
        raise CheckpointError(f"a checkpoint holds values by their names, and {name!r} is none: save it by a text.")
    return name


def _placed(value: Any, arrays: list[NDArray[Any]]) -> dict[str, Any]:
    array = np.asarray(value)
    if array.dtype.kind not in KINDS:
        raise CheckpointError(f"a checkpoint holds arrays of numbers, and no {array.dtype}: save it as such.")
    arrays.append(array)
    return {ARRAY: [array.dtype.str, list(value.shape) if isinstance(value, np.ndarray) else None]}


class _Cursor:
    """Takes one array after the other from their bytes."""

    def __init__(self, arrays: bytes) -> None:
        self._arrays, self._place = arrays, 0

    def take(self, kind: str, shape: list[int] | None) -> Any:
        """Return the next array, or scalar; raise `CheckpointError` where there can be none such."""
        dtype = np.dtype(kind)
        if dtype.kind not in KINDS or min((0, *(shape or ()))) < 0:
            raise CheckpointError(f"there is no array of {kind} with shape {shape}")
        count = math.prod(shape or ())
        array = np.frombuffer(self._arrays, dtype, count, self._place) if count else np.empty(0, dtype)
        self._place += array.nbytes
        return array[0] if shape is None else array.reshape(shape).copy()


def _unpacked(value: Any, arrays: _Cursor) -> Any:
    if isinstance(value, list):
        return [_unpacked(each, arrays) for each in value]
    if not isinstance(value, dict):
        return value
    if ARRAY in value:
        kind, shape = value[ARRAY]
        return arrays.take(kind, shape)
    return {name: _unpacked(each, arrays) for name, each in value.items()}
