"""Memory: claimed before it is allocated, so that a scenario that needs too much is refused and not killed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from rtagent.errors import SpecError

MEMORY_INFO = Path("/proc/meminfo")

_ledgers: list[dict[str, int]] = []


def claim(size: int, what: str) -> None:
    """Note that `what` is about to take `size` bytes; raise `SpecError` where the machine has less."""
    available = available_memory()
    claimed = sum(_ledgers[-1].values()) if _ledgers else 0
    if available is not None and claimed + size > available:
        rest = f", after {describe_size(claimed)} for the rest" if claimed else ""
        raise SpecError(
            f"{describe_size(size)} for {what}{rest} is more than the {describe_size(available)} that this machine "
            "has free: ask for less."
        )
    for ledger in _ledgers:
        ledger[what] = ledger.get(what, 0) + size


@contextlib.contextmanager
def ledger() -> Iterator[dict[str, int]]:
    """Collect what is claimed within it: bytes by what they are for."""
    claims: dict[str, int] = {}
    _ledgers.append(claims)
    try:
        yield claims
    finally:
        _ledgers.remove(claims)


def available_memory() -> int | None:
    """Return how many bytes can be allocated without swapping, or None where the machine does not say."""
    try:
        lines = MEMORY_INFO.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    found = [line.split() for line in lines if line.startswith("MemAvailable:")]
    return int(found[0][1]) * 1024 if found else None


def describe_size(size: float) -> str:
    """Write a size with three digits and its unit: `4.8 GB`."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.3g} {unit}"
    return f"{size:.0f} B"
