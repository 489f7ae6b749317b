"""Servos on their way: where each is to be, and the bytes that say so. No I/O; times in ns, angles in rad."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.units import second
from rtagent_drivers.arduino import frames, legacy
from rtagent_drivers.arduino.settings import Servo

WAY = ("known", "_from", "_goal", "_began", "_ends")
"""What is saved of a way."""


class Ramp:
    """A servo's way to its goal, at its `max_velocity`; it knows where the servo was sent, not where it is."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self.forget()

    def forget(self) -> None:
        """Know nothing any more: the servo was let go of."""
        self.known = False
        self._from = self._goal = 0.0
        self._began = self._ends = 0

    def go(self, goal: float, now: int) -> float:
        """Go to `goal` as far as the limits allow; return that. The first way begins at `start`, or at its end."""
        goal = min(max(goal, self._servo.least), self._servo.greatest)
        if not self.known:
            start = self._servo.start
            self._from = self._goal = goal if start is None else start
            self.known = True
        self._from, self._goal, self._began = self.at(now), goal, now
        speed = self._servo.max_velocity
        self._ends = now + (round(abs(self._goal - self._from) / speed * second) if speed else 0)
        return goal

    def stay(self, now: int) -> None:
        """Stay where it is on its way."""
        self._from = self._goal = self.at(now)
        self._ends = now

    def at(self, now: int) -> float:
        """Return where it is to be."""
        if now >= self._ends:
            return self._goal
        return self._from + (self._goal - self._from) * (now - self._began) / (self._ends - self._began)

    def save(self) -> Saved:
        """Return the way that it is on."""
        return save_fields(self, WAY)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_fields(self, WAY, saved)

    @property
    def arrives(self) -> int:
        """When it is at its goal."""
        return self._ends


class ServoBank:
    """All servos of a board; `order` are the pins of the board's servos, in its own order."""

    def __init__(self, servos: Mapping[str, Servo], order: Sequence[int], *, legacy: bool) -> None:
        self._servos, self.legacy = servos, legacy
        self.order = order
        self._ramps = {name: Ramp(servo) for name, servo in servos.items()}

    def forget(self) -> None:
        """Know nothing any more: the servos were let go of."""
        for ramp in self._ramps.values():
            ramp.forget()

    def go(self, name: str, goal: float, now: int) -> float:
        """Send a servo on its way; return its goal within the limits. On a legacy board the others start, too."""
        if self.legacy:
            for other, ramp in self._ramps.items():
                start = self._servos[other].start
                if not ramp.known and start is not None:
                    ramp.go(start, now)
        return self._ramps[name].go(goal, now)

    def stay(self, now: int) -> None:
        """Stay, all of them."""
        for ramp in self._ramps.values():
            ramp.stay(now)

    def start(self, now: int) -> int:
        """Send each that has a start there; return when they arrive."""
        starts = {name: servo.start for name, servo in self._servos.items() if servo.start is not None}
        for name, start in starts.items():
            self.go(name, start, now)
        return max((self._ramps[name].arrives for name in starts), default=now)

    def said(self, now: int) -> bytes:
        """Return what says where they are to be now; nothing where none was sent anywhere."""
        return self._legacy_line(now) if self.legacy else self._frame(now)

    @property
    def on(self) -> bool:
        """Whether any was sent anywhere."""
        return any(ramp.known for ramp in self._ramps.values())

    def moving(self, now: int) -> bool:
        """Return whether any is on its way."""
        return any(now < ramp.arrives for ramp in self._ramps.values())

    def _frame(self, now: int) -> bytes:
        widths = {
            servo.pin: servo.pulse(self._ramps[name].at(now))
            for name, servo in self._servos.items()
            if self._ramps[name].known
        }
        return frames.pulses([widths.get(pin) for pin in self.order]) if widths else b""

    def _legacy_line(self, now: int) -> bytes:
        degrees = {
            servo.pin: round(180 * servo.fraction(self._ramps[name].at(now)))
            for name, servo in self._servos.items()
        }
        return legacy.positions([degrees[pin] for pin in self.order]) if self.on else b""
