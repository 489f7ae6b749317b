"""What figures depend on beside the code: the machine for times, versions of what runs the code for counts."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from collections.abc import Mapping
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
MODEL = re.compile(r"^(?:model name|Model|Hardware)\s*:\s*(.+)$", re.MULTILINE)
PACKAGES = ("numpy", "numba")

Identity = Mapping[str, str]


def machine() -> Identity:
    """Return what times depend on: two machines of one kind are the same."""
    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "processors": str(os.cpu_count()),
    }


def software() -> Identity:
    """Return the versions that counts of allocations depend on."""
    python = f"{platform.python_implementation()} {platform.python_version()}"
    return {"python": python, **{name: _version(name) for name in PACKAGES}}


def differences(then: Identity, now: Identity) -> str:
    """Return in words what is not as it was, or nothing."""
    return ", ".join(
        f"{name} was {then.get(name, 'not told')} and is {now.get(name, 'not told')}"
        for name in sorted({*then, *now})
        if then.get(name) != now.get(name)
    )


def _processor() -> str:
    try:
        found = MODEL.search(CPUINFO.read_text(encoding="utf-8", errors="replace"))
    except OSError:
        found = None
    return found[1].strip() if found else platform.processor() or "unknown"


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "missing"
