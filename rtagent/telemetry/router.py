"""The router that runs and viewers are clients of: one for all of this machine, gone when nobody needs it."""

from __future__ import annotations

import os
import sys
import threading

import msgspec

from rtagent.telemetry.connection import Access, TelemetryError, config, reason, router_settings, zenoh_module
from rtagent.telemetry.manners import give_way

LOOK_EVERY = 1.0
LINGERS = 5
"""So many looks (one each second) without a client, and the router ends."""


def main() -> int:
    """Route between clients until there are none any more; say "ready", or why not."""
    give_way()
    access = msgspec.json.decode(sys.argv[1], type=Access)
    try:
        zenoh = zenoh_module()
        session = zenoh.open(config(router_settings(access)))
    except (TelemetryError, zenoh.ZError) as error:
        _say(reason(error))
        return 1
    _say("ready")
    alone, pause = 0, threading.Event()
    while alone < LINGERS:
        pause.wait(LOOK_EVERY)
        alone = 0 if list(session.info.transports()) else alone + 1
    session.close()
    return 0


def _say(line: str) -> None:
    """Say one thing to whoever started it, and let go of the pipe."""
    os.write(1, line.encode() + b"\n")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)


if __name__ == "__main__":
    sys.exit(main())
