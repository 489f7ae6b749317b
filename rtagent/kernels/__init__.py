"""Compiled kernels, loaded only where one is wanted: the compiler is never imported otherwise.

Each module here has the fast form of a readable one of the same name in `rtagent.features` or
`rtagent.learning`, which runs where there is no compiler, and which the tests compare with.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import sys
import threading
import warnings
from collections.abc import Iterator
from types import ModuleType

SILENCE = 1.0
"""Compiling for longer than this (s) is told."""

_plain = 0
_warned = False


def load(name: str) -> ModuleType | None:
    """Return the kernels of module `name`, compiled for this processor, or None where the plain forms must do.

    They are compiled once and kept for later runs. Call it while an object is made, never within a run.
    """
    if _plain:
        return None
    if importlib.util.find_spec("numba") is None:
        _warn()
        return None
    with _telling(name):
        return importlib.import_module(f"rtagent.kernels.{name}")


@contextlib.contextmanager
def plain() -> Iterator[None]:
    """Make what is made within it use the plain forms."""
    global _plain
    _plain += 1
    try:
        yield
    finally:
        _plain -= 1


def _warn() -> None:
    global _warned
    if not _warned:
        _warned = True
        warnings.warn(
            "numba is not installed, so features and learners run in their plain numpy forms, "
            "10 to 100 times slower: pip install numba.",
            RuntimeWarning,
            stacklevel=4,
        )


@contextlib.contextmanager
def _telling(name: str) -> Iterator[None]:
    """Say so where loading takes long."""
    line = f"rtagent: getting the kernels for {name} ready; once compiled, they are kept for later runs.\n"
    timer = threading.Timer(SILENCE, lambda: sys.stderr.write(line))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
