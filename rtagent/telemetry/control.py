"""Commands of a viewer's to a run: stop, annotate, press."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rtagent.telemetry.connection import TelemetryError
from rtagent.telemetry.keys import Place

if TYPE_CHECKING:
    from zenoh import Session

PATIENCE = 2.0
"""How long (s) an answer is waited for."""


def command(session: Session, place: Place, name: str, text: str = "") -> str:
    """Give a command to a run, and return what it answers; raise `TelemetryError` where it takes none.

    `stop` takes a reason, `annotate` what is to be remembered, `press` the name of a button. The session is one of
    `rtagent.telemetry.connection.open_client`.
    """
    for reply in session.get(place.control(name), payload=text, timeout=PATIENCE):
        if reply.ok is not None:
            return str(reply.ok.payload.to_string())
        if reply.err is not None:
            raise TelemetryError(reply.err.payload.to_string())
    raise TelemetryError(
        f"the run {place.run_id} of {place.agent} takes no commands: set telemetry.control = true in its scenario, "
        "or it has ended."
    )
