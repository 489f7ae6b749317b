"""From scans to samples: numbers, times, values, and what was lost on the way. No I/O."""

from __future__ import annotations

from collections.abc import Sequence

from rtagent.experience import Sample
from rtagent.specs import Value
from rtagent.units import second
from rtagent_drivers.arduino.board_clock import BoardClock
from rtagent_drivers.arduino.messages import Scan
from rtagent_drivers.arduino.settings import Settings, value

NUMBERS = 1 << 16


class Sampler:
    """Makes samples of a board's scans; `pins` are those of its channels in its own order, `latency` is in ns.

    The board's times are fitted to the host's; where it gives none, they are those of arrival.
    """

    def __init__(self, settings: Settings, pins: Sequence[str], latency: int) -> None:
        order = list(pins)
        self._count = len(order)
        self._channels = [
            (name, channel, pin, order.index(pin))
            for (name, channel), pin in zip(settings.inputs.items(), settings.pins, strict=True)
        ]
        self._latency = latency
        self.lost = 0
        self.sequence = -1
        self._last_time = 0
        self.restart()

    def restart(self) -> None:
        """Begin anew, as the board has; sequence numbers go on."""
        self.clock = BoardClock(self._latency)
        self._number: int | None = None
        self._heard_at: tuple[int, int] | None = None

    def fits(self, scan: Scan) -> bool:
        """Return whether a scan has all channels."""
        return len(scan.readings) == self._count

    def take(self, scans: Sequence[Scan], arrival: int) -> Sample:
        """Return the sample of the newest of some scans, which arrived together."""
        for scan in scans:
            self._count_numbers(scan)
        newest = scans[-1]
        world_time = arrival
        if newest.micros is not None:
            world_time = self._fitted(newest.micros, arrival)
        self._last_time = world_time = max(self._last_time, min(world_time, arrival))
        source = "arrival" if newest.micros is None else "device"
        return Sample(self._values(newest), world_time, arrival, self.sequence, source)  # type: ignore[arg-type]

    def stood_still(self, scan: Scan, arrival: int) -> bool:
        """Return whether the board's time does not fit to the one before it: it was reset meanwhile."""
        if scan.micros is None or self._heard_at is None:
            return False
        micros, heard = self._heard_at
        board, host = (scan.micros - micros) % (1 << 32) * 1000, arrival - heard
        return abs(board - host) > second + host // 10

    def _fitted(self, micros: int, arrival: int) -> int:
        self._heard_at = micros, arrival
        time = self.clock.unwrapped(micros)
        self.clock.hear(time, arrival)
        return self.clock.at(time)

    def _count_numbers(self, scan: Scan) -> None:
        step = 1
        if scan.number is not None:
            step = 1 if self._number is None else (scan.number - self._number) % NUMBERS or NUMBERS
            self._number = scan.number
        self.lost += step - 1
        self.sequence += step

    def _values(self, scan: Scan) -> dict[str, Value]:
        readings = scan.readings
        return {name: value(channel, pin, readings[at]) for name, channel, pin, at in self._channels}
