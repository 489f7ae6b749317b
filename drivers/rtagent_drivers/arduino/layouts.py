"""The formats that boards speak, by the names that scenarios give them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rtagent_drivers.arduino import legacy
from rtagent_drivers.arduino.frames import FrameDecoder
from rtagent_drivers.arduino.messages import Decoder

Format = Literal["rtagent", "handi", "glovi", "glovi_binary"]

HANDI = (
    "M",
    "D0",
    "D1P",
    "D1I",
    "D1D",
    "D2P",
    "D2I",
    "D3P",
    "D3I",
    "D4P",
    "D5P",
    *(f"FSR{n}" for n in range(1, 6)),
)
GLOVI = tuple(f"A{n}" for n in range(6))

POTENTIOMETERS = ("D0", "D1P", "D1D", "D2P", "D2I", "D3P", "D3I", "D4P", "D5P")
HANDI_PINS: Mapping[str, str] = {
    "M": "2",
    **{field: f"A{number}" for number, field in enumerate(POTENTIOMETERS, start=2)},
    **{f"FSR{number}": f"A{number + 10}" for number in range(1, 6)},
}
"""Where the fields of the HANDi Hand's lines are measured on its Mega; `D1I` is a constant 0."""

HANDI_SERVOS = (3, 5, 6, 9, 10, 11)


@dataclass(frozen=True)
class Layout:
    """A format: the names of its channels and the pins of its servos, which of ours the board tells itself.

    `rate` (Hz) and `baud` (bit/s) are what its sketch is known with; `encode` makes bytes of a scan.
    """

    decoder: Callable[[], Decoder]
    channels: tuple[str, ...] = ()
    servos: tuple[int, ...] = ()
    rate: float = 100.0
    baud: int = 1_000_000
    encode: Callable[[Sequence[int]], bytes] | None = None

    @property
    def legacy(self) -> bool:
        """Whether it is one of those that know no hello, no times and no heartbeat."""
        return bool(self.channels)


LAYOUTS: Mapping[Format, Layout] = {
    "rtagent": Layout(FrameDecoder),
    "handi": Layout(
        lambda: legacy.LineDecoder(len(HANDI), frozenset((0,))),
        HANDI,
        HANDI_SERVOS,
        70.0,
        38_400,
        lambda readings: legacy.line(readings, ","),
    ),
    "glovi": Layout(
        lambda: legacy.LineDecoder(len(GLOVI)),
        GLOVI,
        (),
        132.0,
        38_400,
        lambda readings: legacy.line(readings, ", "),
    ),
    "glovi_binary": Layout(legacy.WordDecoder, GLOVI, (), 200.0, 38_400, legacy.words),
}


def is_switch(pin: str) -> bool:
    """Return whether a channel is digital: a pin by its number, or the button of the HANDi Hand's lines."""
    return pin.isdigit() or pin == "M"
