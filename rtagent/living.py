"""The runs that hold hardware now: a locked file for each, so that `rtagent stop` finds them.

In `$XDG_RUNTIME_DIR/rtagent`, or in `rtagent-UID` in the folder of temporary files; nobody else may look in.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from rtagent.errors import DeviceError


@dataclass(frozen=True)
class LivingRun:
    """A run: its process, its scenario, and the hardware that it holds."""

    pid: int
    scenario: str
    hardware: Sequence[str]


@contextmanager
def told(scenario: str, hardware: Sequence[str]) -> Iterator[None]:
    """Tell others of this run, within the block; raise `DeviceError` where there is no safe place for it."""
    import fcntl  # not on every system that can run fakes

    handle, name = tempfile.mkstemp("", f"{os.getpid()}-", _folder())
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        json.dump({"pid": os.getpid(), "scenario": scenario, "hardware": list(hardware)}, file)
        file.flush()
        place = Path(name).rename(f"{name}.json")  # found only now that it is locked
        try:
            yield
        finally:
            place.unlink(missing_ok=True)


def runs() -> list[LivingRun]:
    """Return the runs that live, and forget those that do not."""
    return [run for place in sorted(_folder().glob("*.json")) if (run := _living(place)) is not None]


def _living(place: Path) -> LivingRun | None:
    try:
        with place.open(encoding="utf-8") as file:
            if _is_locked(file):
                return LivingRun(**json.load(file))
            place.unlink(missing_ok=True)
    except (OSError, ValueError, TypeError):
        pass
    return None


def _is_locked(file: IO[str]) -> bool:
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False


def _folder() -> Path:
    """Return the folder, made where it is missing; one of somebody else's is refused."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "rtagent" if runtime else Path(tempfile.gettempdir()) / f"rtagent-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise DeviceError(
            f"{folder} cannot be made: {error}. Set XDG_RUNTIME_DIR to a folder of your own."
        ) from None
    if found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise DeviceError(
            f"others may write to {folder}: remove it, or set XDG_RUNTIME_DIR to a folder of your own."
        )
    return folder
