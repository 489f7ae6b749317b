"""An emulated board: bytes in and out at times that it is told; no I/O.

It does what the sketches in firmware/ do, or those of the HANDi Hand and the GLOVi Glove.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rtagent.units import ms, second, us
from rtagent_drivers.arduino import frames
from rtagent_drivers.arduino.bodies import Body
from rtagent_drivers.arduino.emulated.faults import Fault, Trouble
from rtagent_drivers.arduino.layouts import HANDI_PINS, LAYOUTS, Format
from rtagent_drivers.arduino.messages import Hello, Safety, ServoState
from rtagent_drivers.arduino.settings import BITS_A_BYTE, FRAME_BYTES
from rtagent_drivers.emulation.command import Log

READING_TIMES = [116 * us, 60 * us, 32 * us, 18 * us]
"""What a channel takes with each clock of the converter; the slowest is used that leaves time for the rest."""

ENCODING, SENDING = 130 * us, 16 * us
"""What the sketch takes to make a frame of its readings, and to send each byte of it."""

PULSES = 544, 2400
"""The pulses (µs) at the ends of a servo's range."""


@dataclass(frozen=True)
class Make:
    """What board it is: its format, pins and rates; its clock is fast by `drift`; it starts within `boot` (ns)."""

    format: Format = "rtagent"
    channels: Sequence[str] = ()
    servos: Sequence[int] = ()
    rate: float = 100.0
    baud: int = 1_000_000
    drift: float = 0.0
    boot: int = 0
    faults: Sequence[Fault] = field(default=())


class EmulatedBoard:
    """A board with a body on its pins; `line_baud` returns at what the program has set the line (0: it is gone)."""

    def __init__(
        self, make: Make, body: Body, now: int, line_baud: Callable[[], int], log: Log | None = None
    ) -> None:
        self._make, self.body, self._line_baud, self._log = make, body, line_baud, log
        self._layout = LAYOUTS[make.format]
        self._there_since = self._advanced_to = now
        self.trouble = Trouble(make.faults)
        self.overridden: dict[str, int] = {}
        self._said: list[tuple[int, bytes]] = []
        self.reset(now)

    # What happens to it

    def reset(self, now: int) -> None:
        """Start anew: nothing is said before it has started, and no servo gets pulses."""
        self._started_at = now + self._make.boot
        self._hello = Hello(
            frames.VERSION,
            started=True,
            period=round(second / self._make.rate / us) * us,
            heartbeat=200 * ms,
            channels=tuple(self._make.channels),
            servos=tuple(self._make.servos),
        )
        self._greeted = False
        self._number, self._next_scan = 0, self._started_at + self._hello.period
        self._safety, self._pulses, self._heard_at = Safety.TOLD_TO, [0] * len(self._make.servos), now
        self._rest, self._bad = b"", 0
        self._said.clear()
        for servo in range(len(self._pulses)):
            self.body.turn(now, servo, None)

    def receive(self, now: int, data: bytes, baud: int) -> None:
        """Take what the host says, unless it comes at another rate than the board's, or before it has started."""
        self._advance(now)
        deaf = self.trouble.holds("deaf", self.age(now))
        if now < self._started_at or baud != self._make.baud or deaf:
            return
        if self._layout.legacy:
            self._obey_positions(now, data)
            return
        *pieces, self._rest = (self._rest + data).split(b"\0")
        for piece in pieces:
            told = frames.contents(piece) if piece else None
            if told is not None:
                self._obey(now, told[:1], told[1:])
            else:
                self._bad += bool(piece)

    def due(self) -> int | None:
        """Return when it has next something to say, or something happens to it."""
        times = [self._started_at if not self._greeted else self._next_scan, *(time for time, _ in self._said[:1])]
        if self._safety == Safety.MOVING:
            times.append(self._heard_at + self._hello.heartbeat + ms)
        edge = self.trouble.due(self._advanced_to - self._there_since)
        return min([*times, *([] if edge is None else [self._there_since + edge])])

    def take(self, now: int) -> bytes:
        """Return what has reached the host by `now`."""
        self._advance(now)
        ready = [data for time, data in self._said if time <= now]
        del self._said[: len(ready)]
        data = b"".join(ready)
        baud = self._line_baud()
        if not data or not baud or self.unplugged:
            return b""
        return data if baud == self._make.baud else self.trouble.garbage(len(data))

    @property
    def unplugged(self) -> bool:
        """Whether the line is gone."""
        return self.trouble.holds("unplug", self.age(self._advanced_to))

    def age(self, now: int) -> int:
        """Return how long (ns) the board has been there."""
        return now - self._there_since

    # What it does

    def _advance(self, now: int) -> None:
        self._advanced_to = now
        if not self._greeted and now >= self._started_at:
            self._greeted = True
            self._say_hello(self._started_at, started=True)
        while self._next_scan <= now:
            self._scan(self._next_scan)
            self._next_scan += round(self._hello.period / (1.0 + self._make.drift))
        silent = now - self._heard_at > self._hello.heartbeat
        if self._safety == Safety.MOVING and silent and not self._layout.legacy:
            self._make_safe(now, Safety.UNHEARD)

    def _scan(self, time: int) -> None:
        taken = time + self._scan_time // 2
        readings = [self._reading(pin, taken) for pin in self._make.channels]
        if self._layout.encode is not None:
            data = self._layout.encode(readings)
        else:
            data = frames.scan(readings, self._number % 65536, self._micros(taken))
        self._note({"scan": self._number, "time": taken})
        self._number += 1
        self._say(time + self._scan_time + ENCODING, data)

    def _reading(self, pin: str, time: int) -> int:
        return self.overridden.get(pin, self.body.reading(pin, time))

    @property
    def _scan_time(self) -> int:
        times = [len(self._make.channels) * each for each in READING_TIMES]
        left = self._hello.period * 9 // 10 - ENCODING - self._sending_time
        return next((time for time in times if time <= left), times[-1])

    @property
    def _sending_time(self) -> int:
        return (FRAME_BYTES + 2 * len(self._make.channels)) * SENDING

    def _micros(self, time: int) -> int:
        return int((time - self._started_at) * (1.0 + self._make.drift)) // us % (1 << 32)

    def _say(self, time: int, data: bytes) -> None:
        """Put bytes on the line; what is said later arrives later."""
        since = time - self._there_since
        data = self.trouble.spoil(since, data)
        arrives = time + len(data) * BITS_A_BYTE * second // self._make.baud + self.trouble.delay(since)
        if data:
            self._said.append((max([arrives, *(time for time, _ in self._said[-1:])]), data))

    def _say_hello(self, now: int, *, started: bool) -> None:
        if not self._layout.legacy:
            ready = self._scan_time + ENCODING
            takes, lag = ready + self._sending_time, ready - self._scan_time // 2
            told = self._hello._replace(started=started, scan=takes, lag=lag)
            self._say(now, frames.hello(told))

    def _say_state(self, now: int) -> None:
        self._say(now, frames.servo_state(ServoState(self._safety, self._bad, tuple(self._pulses))))

    def _obey(self, now: int, kind: bytes, body: bytes) -> None:
        self._heard_at = now
        if kind == b"h":
            self._say_hello(now, started=False)
        elif kind == b"c" and len(body) == 7:
            self._configure(now, body)
        elif kind == b"a":
            self._safety = Safety.MOVING
        elif kind == b"s":
            self._make_safe(now, Safety.TOLD_TO)
        elif kind == b"v" and len(body) == 2 * len(self._pulses):
            if self._safety == Safety.MOVING:
                self._move(now, body)
            else:
                self._say_state(now)

    def _configure(self, now: int, body: bytes) -> None:
        period, heartbeat = int.from_bytes(body[:4], "little") * us, int.from_bytes(body[4:6], "little") * ms
        self._hello = self._hello._replace(period=period, heartbeat=heartbeat, holds=bool(body[6]))
        self._next_scan = now + period
        self._say_hello(now, started=False)

    def _move(self, now: int, body: bytes) -> None:
        for servo in range(len(self._pulses)):
            width = int.from_bytes(body[2 * servo : 2 * servo + 2], "little")
            if width not in (frames.UNCHANGED, self._pulses[servo]):
                self._pulse(now, servo, width)

    def _pulse(self, now: int, servo: int, width: int) -> None:
        self._pulses[servo] = width
        least, most = PULSES
        self.body.turn(now, servo, (width - least) / (most - least) if width else None)
        self._note({"servo": self._make.servos[servo], "pulse": width, "time": now})

    def _make_safe(self, now: int, why: Safety) -> None:
        if not self._hello.holds:
            for servo, width in enumerate(self._pulses):
                if width:
                    self._pulse(now, servo, 0)
        self._safety = why
        self._note({"safe": why.name.lower(), "time": now})
        self._say_state(now)

    def _obey_positions(self, now: int, data: bytes) -> None:
        """Take the positions that a legacy hand is told: degrees, separated by commas, ended by a point."""
        *told, self._rest = (self._rest + data).split(b".")
        for line in told:
            fields = line.split(b",")
            if len(fields) == len(self._pulses) and all(each.isdigit() for each in fields):
                for servo, degrees in enumerate(fields):
                    width = round(PULSES[0] + (PULSES[1] - PULSES[0]) * min(int(degrees), 180) / 180)
                    if width != self._pulses[servo]:
                        self._pulse(now, servo, width)

    def _note(self, what: Mapping[str, Any]) -> None:
        if self._log is not None:
            self._log(what)


HAND = Make(channels=tuple(HANDI_PINS.values()), servos=LAYOUTS["handi"].servos, rate=70.0)
GLOVE = Make(channels=LAYOUTS["glovi"].channels, rate=750.0)
"""The boards that the sketches in firmware/ are for."""
