"""What goes wrong with an emulated board and its line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from random import Random
from typing import ClassVar, Literal

from rtagent.errors import SpecError
from rtagent.units import Duration
from rtagent_drivers.fake import CLOSED_SETTINGS

Kind = Literal["silent", "corrupt", "cut", "noise", "jitter", "deaf", "unplug"]


@dataclass(frozen=True)
class Fault:
    """A fault from `begin` on, for `duration` (0: for ever); times since the board was there.

    Each thing that the board says is with `probability` not said (silent), spoilt (corrupt), cut short (cut), or
    preceded by garbage (noise); with jitter all is later, by up to `delay`. A deaf board hears nothing; unplugged,
    the line is gone.
    """

    __pydantic_config__: ClassVar = CLOSED_SETTINGS

    kind: Kind
    begin: Duration = 0
    duration: Duration = 0
    probability: float = 1.0
    delay: Duration = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.probability <= 1.0:
            raise SpecError(f"the probability of a fault is {self.probability}: give 0 to 1.")

    def holds(self, time: int) -> bool:
        """Return whether it is so at a time since the board was there."""
        return self.begin <= time and (not self.duration or time < self.begin + self.duration)


class Trouble:
    """The faults of a board, and what they do to what it says. Times since the board was there."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        self.faults = list(faults)
        self._random = Random(0)  # noqa: S311  # garbage needs no secrecy

    def holds(self, kind: Kind, time: int) -> bool:
        """Return whether there is such a fault."""
        return any(fault.kind == kind and fault.holds(time) for fault in self.faults)

    def due(self, time: int) -> int | None:
        """Return when a fault next begins or ends."""
        edges = [
            edge
            for fault in self.faults
            for edge in (fault.begin, fault.begin + fault.duration if fault.duration else 0)
        ]
        return min((edge for edge in edges if edge > time), default=None)

    def spoil(self, time: int, data: bytes) -> bytes:
        """Return what becomes of what the board says."""
        for fault in self.faults:
            if fault.holds(time) and self._random.random() < fault.probability:
                data = self._spoilt(fault.kind, data)
        return data

    def delay(self, time: int) -> int:
        """Return by how much (ns) what the board says is late."""
        most = sum(fault.delay for fault in self.faults if fault.kind == "jitter" and fault.holds(time))
        return self._random.randint(0, most)

    def garbage(self, size: int) -> bytes:
        """Return bytes that mean nothing."""
        return self._random.randbytes(size)

    def _spoilt(self, kind: Kind, data: bytes) -> bytes:
        if kind == "silent":
            return b""
        if kind == "corrupt" and data:
            at = self._random.randrange(len(data))
            return data[:at] + bytes((data[at] ^ 0x55,)) + data[at + 1 :]
        if kind == "cut":
            return data[: len(data) // 2]
        return self.garbage(self._random.randint(1, 16)) + data if kind == "noise" else data
