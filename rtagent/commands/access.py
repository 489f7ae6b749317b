"""Where telemetry is, and as whom to connect, as the command line says."""

from __future__ import annotations

import argparse

import msgspec

from rtagent.scenario import load
from rtagent.telemetry.connection import Access
from rtagent.telemetry.wishes import access_of

OPTIONS = ("endpoint", "user", "password_file", "ca")


def access(arguments: argparse.Namespace) -> Access:
    """Return it: what the scenario says, if one is given, and the options over that; raise `ScenarioError`."""
    base = access_of(load(arguments.scenario).model.telemetry) if arguments.scenario else Access()
    given = {name: getattr(arguments, name) for name in OPTIONS if getattr(arguments, name)}
    return msgspec.structs.replace(base, **given)
