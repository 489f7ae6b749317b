"""An emulated arm in a process of its own, as `rtagent emulate` runs it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MODULE = "rtagent_drivers.dynamixel.emulated.pty"


@contextmanager
def emulated(robot: str, link: Path, *arguments: str) -> Iterator[str]:
    """Give the path of its port; the emulator ends with its standard input."""
    command = [sys.executable, "-m", MODULE, robot, "--link", str(link), "--linger", "0s", *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        try:
            assert process.stdout.readline().strip() == str(link)
            yield str(link)
        finally:
            process.stdin.close()
            process.wait(timeout=20)
