"""A film as a device: its newest frame is a function of the clock, whoever looks."""

from __future__ import annotations

from rtagent.clock import current
from rtagent.errors import DisconnectedError, SpecError
from rtagent.experience import Command, Sample
from rtagent.specs import DeviceSpec
from rtagent_drivers.webcam.features import Features
from rtagent_drivers.webcam.pictures import picture_of
from rtagent_drivers.webcam.scenes import Film


class FilmDevice:
    """A film whose frames reach the host `delay` (ns) after they are due; it begins when it is first opened."""

    def __init__(self, film: Film, features: Features, delay: int) -> None:
        self._film, self._features, self._delay = film, features, delay
        self.spec = DeviceSpec(sensors=features.specs, rate=film.rate)
        self._opened, self._start = False, -1
        self._sample: Sample | None = None

    async def open(self) -> None:
        """Begin to play, or go on."""
        self._clock = current()
        self._opened = True
        if self._start < 0:
            self._start = self._clock.now()

    async def read(self, newer_than: int) -> Sample:
        """Return what is sensed of the newest frame, or wait for one above `newer_than`."""
        self._check_open()
        while (number := self._newest()) <= max(newer_than, -1):
            await self._clock.sleep_until(self._arrival(max(newer_than, number) + 1))
            self._check_open()
        if self._sample is None or self._sample.sequence != number:
            values = self._features(picture_of(self._film.pixels(number)))
            arrival = self._arrival(number)
            self._sample = Sample(values, arrival - self._delay, arrival, number, "device")
        return self._sample

    async def act(self, command: Command) -> Command:
        """Refuse: it can only be watched."""
        for name in command:
            raise SpecError(f"a webcam has no actuator {name!r}.")
        return {}

    async def make_safe(self) -> None:
        """Do nothing: it moves nothing."""

    async def close(self) -> None:
        """Stop looking; it plays on."""
        self._opened = False

    def next_event(self, now: int) -> int | None:
        """Return when the next frame arrives."""
        return self._arrival(self._film.number(now - self._start - self._delay) + 1)

    def _newest(self) -> int:
        return self._film.number(self._clock.now() - self._start - self._delay)

    def _arrival(self, number: int) -> int:
        return self._start + self._film.taken(number) + self._delay

    def _check_open(self) -> None:
        if not self._opened:
            raise DisconnectedError("the film is closed: open it first.")
