"""When the samples of a fake arrive at the host: at a rate, late, lost, doubled, out of order; drawn beforehand."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

from numpy.random import Generator

FIRST_BLOCK = 1024


@dataclass(frozen=True)
class Disturbance:
    """Probabilities, for each sample, that it is lost, doubled, corrupted, or `lateness` (ns) late."""

    drop: float
    duplicate: float
    corrupt: float
    late: float
    lateness: int


class Arrival(NamedTuple):
    """A sample on its way: its number, when it was taken and when it arrives (ns)."""

    sequence: int
    taken: int
    arrival: int
    corrupt: bool


class Arrivals:
    """The samples of one episode that begins at `start` (ns), one every `period` (ns)."""

    def __init__(
        self,
        start: int,
        period: float,
        delay: int,
        jitter: int,
        disturbance: Disturbance | None,
        rng: Generator,
    ) -> None:
        self._start, self._period, self._delay, self._jitter = start, period, delay, jitter
        self._disturbance, self._rng = disturbance, rng
        self._known: list[Arrival] = []
        self._times: list[int] = []
        self._newest: list[int] = []
        self._lost: list[int] = []
        self._drawn = 0
        self._extend(FIRST_BLOCK)

    def newest(self, now: int) -> Arrival | None:
        """Return the sample of the highest number among those that have arrived, or None."""
        place = self._place(now)
        return self._known[self._newest[place - 1]] if place else None

    def next_arrival(self, now: int) -> int:
        """Return when the next sample arrives after `now`, or when to look again where none is known to."""
        place = self._place(now)
        if place == len(self._times) or self._times[place] >= self._horizon():
            self._extend(self._drawn)
        # what is not drawn yet could arrive before what is
        return min([*self._times[place : place + 1], self._horizon()])

    def counters(self, now: int) -> Mapping[str, int]:
        """Return what happened to the samples that were to arrive until `now`."""
        arrived = [arrival.sequence for arrival in self._known[: self._place(now)]]
        overtaken = sum(number < highest for number, highest in zip(arrived, accumulate(arrived, max), strict=True))
        return {
            "samples_lost": sum(arrival <= now for arrival in self._lost),
            "samples_doubled": len(arrived) - len(set(arrived)),
            "samples_overtaken": overtaken,
        }

    def _place(self, now: int) -> int:
        """Return how many samples have arrived, drawing more where the drawn ones do not reach `now`."""
        while self._horizon() <= now:
            self._extend(self._drawn)
        return bisect_right(self._times, now)

    def _horizon(self) -> int:
        """Return the earliest moment at which a sample that was not drawn yet could arrive."""
        return self._taken(self._drawn) + self._delay

    def _taken(self, number: int) -> int:
        return self._start + round(number * self._period)

    def _extend(self, count: int) -> None:
        numbers = range(self._drawn, self._drawn + count)
        late = self._rng.integers(0, self._jitter, count, endpoint=True).tolist()
        sent = [
            Arrival(number, taken := self._taken(number), taken + self._delay + jitter, corrupt=False)
            for number, jitter in zip(numbers, late, strict=True)
        ]
        self._drawn += count
        self._known += self._disturbed(sent)
        self._known.sort(key=lambda arrival: (arrival.arrival, arrival.sequence))
        self._times = [arrival.arrival for arrival in self._known]
        self._newest = _newest_places(self._known)

    def _disturbed(self, sent: list[Arrival]) -> list[Arrival]:
        if self._disturbance is None:
            return sent
        arrivals = []
        for arrival, chance in zip(sent, self._rng.random((len(sent), 4)).tolist(), strict=True):
            disturbed = _disturb(arrival, self._disturbance, chance)
            arrivals += disturbed
            if not disturbed:
                self._lost.append(arrival.arrival)
        return arrivals


def _disturb(arrival: Arrival, disturbance: Disturbance, chance: list[float]) -> list[Arrival]:
    if chance[0] < disturbance.drop:
        return []
    if chance[1] < disturbance.late:
        arrival = arrival._replace(arrival=arrival.arrival + disturbance.lateness)
    if chance[2] < disturbance.corrupt:
        arrival = arrival._replace(corrupt=True)
    return [arrival] * (2 if chance[3] < disturbance.duplicate else 1)


def _newest_places(known: list[Arrival]) -> list[int]:
    """Return, for each arrival, the place of the highest number that has arrived by then."""
    places: list[int] = []
    for place, arrival in enumerate(known):
        before = places[-1] if places else place
        places.append(place if arrival.sequence >= known[before].sequence else before)
    return places
