"""What stays latched after a run that was stopped: a file for each piece of hardware, until a person removes it.

In `$XDG_STATE_HOME/rtagent/latched`, or under `~/.local/state`. The watchdog writes here too: few imports.
"""

from __future__ import annotations

import hashlib
import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple


class Entry(NamedTuple):
    """Why, when (ISO 8601) and in which scenario a piece of hardware was stopped."""

    hardware: str
    reason: str
    scenario: str
    time: str

    def __str__(self) -> str:
        """Return it as a sentence without its end."""
        scenario = f" (scenario {self.scenario})" if self.scenario else ""
        return f"{self.hardware} was latched at {self.time}: {self.reason.rstrip('.')}{scenario}"


def latch(hardware: str, reason: str, scenario: str) -> None:
    """Latch a piece of hardware; what was latched before stays as it is, and what has no name cannot be."""
    if not hardware or find(hardware) is not None:
        return
    entry = Entry(hardware, reason, scenario, datetime.now(UTC).isoformat(timespec="seconds"))
    place = _place(hardware)
    place.parent.mkdir(parents=True, exist_ok=True)
    new = place.with_suffix(f".{os.getpid()}")
    new.write_text(json.dumps(entry._asdict()), encoding="utf-8")
    new.replace(place)


def find(hardware: str) -> Entry | None:
    """Return why a piece of hardware is latched, or None where it is not; a file that is damaged latches too."""
    try:
        return Entry(**json.loads(_place(hardware).read_text(encoding="utf-8")))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError) as error:
        return Entry(hardware, f"the file that says why cannot be read: {error!r}", "", "an unknown time")


def release(hardware: str) -> None:
    """Take the latch away."""
    _place(hardware).unlink(missing_ok=True)


def _place(hardware: str) -> Path:
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    name = hashlib.sha256(hardware.encode()).hexdigest()[:32]
    return Path(home) / "rtagent" / "latched" / f"{name}.json"
