"""What a report was made with, and on: versions, and the machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
from pathlib import Path

from rtagent import __version__
from rtagent.memory import describe_size

PACKAGES = ("numpy", "numba", "joblib", "matplotlib")
CPU_INFO, MEMORY_INFO = Path("/proc/cpuinfo"), Path("/proc/meminfo")


def versions() -> str:
    """Return the versions of all that decides a figure."""
    others = [f"{name} {version}" for name in PACKAGES if (version := _version(name))]
    return ", ".join([f"rtagent {__version__}", f"Python {platform.python_version()}", *others])


def machine() -> str:
    """Return the processor, how many there are, the memory and the system, as far as they are known."""
    model = _first(CPU_INFO, r"model name\s*:\s*(.+)") or platform.processor() or platform.machine()
    kilobytes = _first(MEMORY_INFO, r"MemTotal:\s*(\d+)")
    memory = [f"{describe_size(int(kilobytes) * 1024)} of memory"] if kilobytes else []
    return ", ".join([f"{os.cpu_count()} × {model}", *memory, f"{platform.system()} {platform.release()}"])


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _first(path: Path, pattern: str) -> str:
    try:
        found = re.search(pattern, path.read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return ""
    return found[1].strip() if found else ""
