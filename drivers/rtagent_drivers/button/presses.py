"""What a button was told, and what of it is shown: nothing is lost because nobody looked just then."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from typing import NamedTuple

from rtagent.experience import Sample, Stimulus, TimeSource
from rtagent.specs import DeviceSpec, Spec

PRESSED = "pressed"
SPEC = DeviceSpec(sensors={PRESSED: Spec.flag()}, rate=float("inf"))

MOST_WAITING = 16
"""Changes that wait to be shown; more only come where nobody reads the button."""

MOST_STIMULI = 1024


class Change(NamedTuple):
    """A press or a release: when it was and when it arrived (ns)."""

    pressed: bool
    time: int
    arrival: int
    time_source: TimeSource


class Presses:
    """The changes of a button, shown one after the other, each until it was seen.

    A press stays shown for `shortest` (ns) after it was first seen, so that whoever looks twice in a cycle does not
    miss it. Where too many wait, the oldest press that was not seen is left out with its release, and counted as
    `presses_not_shown`. Its stimulus remains.
    """

    def __init__(self, shortest: int) -> None:
        self._shortest = shortest
        self.counters: Counter[str] = Counter()
        self._number = -1
        self._seen_at: int | None = None
        self._waiting: deque[Change] = deque()
        self._stimuli: deque[Stimulus] = deque(maxlen=MOST_STIMULI)
        self.told = False
        """Whether it is pressed, shown or not."""
        self._show(Change(False, 0, 0, "arrival"))

    def begin(self, now: int) -> None:
        """Show the present state as one since `now`, and forget what is past."""
        self._waiting.clear()
        self._show(Change(self.told, now, now, "arrival"))

    def add(self, change: Change) -> None:
        """Take a press or a release; one that changes nothing is counted and left out."""
        if change.pressed == self.told:
            self.counters["presses_again" if change.pressed else "releases_again"] += 1
            return
        last = self._waiting[-1].time if self._waiting else self._shown.time
        change = change._replace(time=max(change.time, last + 1))  # what is seen already is past
        self.told = change.pressed
        self._waiting.append(change)
        if change.pressed:
            self.counters["presses"] += 1
            self._stimuli.append(Stimulus(change.time, "press", change.time_source))
        if len(self._waiting) > MOST_WAITING:
            self._leave_out()

    def sample(self, now: int) -> Sample:
        """Return what is shown at `now`; it has been seen with that."""
        if self.due is not None and self.due <= now:
            self._show(self._waiting.popleft())
        if self._seen_at is None:
            self._seen_at = now
        shown = self._shown
        return Sample({PRESSED: shown.pressed}, shown.time, shown.arrival, self._number, shown.time_source)

    @property
    def due(self) -> int | None:
        """When (ns) the next change may be shown; None where none waits, or what is shown was not seen yet."""
        if not self._waiting or self._seen_at is None:
            return None
        return self._seen_at + (self._shortest if self._shown.pressed else 0)

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the presses with after < time <= until (ns), in order."""
        return [stimulus for stimulus in self._stimuli if after < stimulus.time <= until]

    def _show(self, change: Change) -> None:
        self._shown, self._seen_at = change, None
        self._number += 1

    def _leave_out(self) -> None:
        """Leave out two changes, so that those before and after them still alternate."""
        first = next(place for place, change in enumerate(self._waiting) if change.pressed)
        del self._waiting[first + 1], self._waiting[first]
        self.counters["presses_not_shown"] += 1
