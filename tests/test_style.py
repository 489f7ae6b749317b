"""The code is formatted, linted and typed; a tool that is missing fails here rather than being skipped."""

from __future__ import annotations

import subprocess
import sys

import pytest
from parts import ROOT


@pytest.mark.parametrize("tool", ["ruff check", "ruff format --check", "mypy"])
def test_the_code_passes(tool: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *tool.split()], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
