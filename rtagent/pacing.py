"""Pacing: a cycle on absolute deadlines, with overruns counted."""

from __future__ import annotations

from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.schedule import Overrun


class Pacer:
    """The deadlines of a paced cycle; all times in ns."""

    def __init__(self, period: int, overrun: Overrun, start: int) -> None:
        self.period, self._overrun = period, overrun
        self._deadline = start
        self.overruns = 0
        self.skipped = 0

    def next(self, now: int) -> int:
        """Return when the next cycle is to begin, given that the last one has ended `now`."""
        self._deadline += self.period
        late = now - self._deadline
        if late > 0:
            self.overruns += 1
            if self._overrun is Overrun.SKIP:
                missed = -(-late // self.period)
                self.skipped += missed
                self._deadline += missed * self.period
        return self._deadline

    def save(self) -> Saved:
        """Return the last deadline, and what was counted."""
        return save_fields(self, ("_deadline", "overruns", "skipped"))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_fields(self, ("_deadline", "overruns", "skipped"), saved)
