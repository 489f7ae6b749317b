"""`rtagent emulate`: hardware that is not there, for any program to talk to."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from rtagent import plugins
from rtagent.errors import PluginError

Emulator = Callable[[Sequence[str]], int]
"""Takes what stands behind its name on the command line; returns the exit code once it was ended."""


def emulate_command(arguments: argparse.Namespace) -> int:
    """Run an emulator by its name until it is ended by a signal."""
    try:
        emulator: Emulator = plugins.load("emulators", arguments.emulator)
    except PluginError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return emulator(arguments.arguments)
