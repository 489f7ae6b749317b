"""The codec of each protocol, by its number."""

from __future__ import annotations

from collections.abc import Mapping

from rtagent.errors import SpecError
from rtagent_drivers.dynamixel.packets import Codec
from rtagent_drivers.dynamixel.protocol1 import PROTOCOL1
from rtagent_drivers.dynamixel.protocol2 import PROTOCOL2

CODECS: Mapping[int, Codec] = {1: PROTOCOL1, 2: PROTOCOL2}


def codec(protocol: int) -> Codec:
    """Return the codec of protocol 1 or 2; raise `SpecError` for another."""
    if protocol not in CODECS:
        raise SpecError(f"protocol is {protocol}: Dynamixel servos speak 1 or 2.")
    return CODECS[protocol]
