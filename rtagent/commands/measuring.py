"""How far measuring is, and how long it will take: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

from rtagent import clock
from rtagent.sweeps.compute import Finished
from rtagent.sweeps.store import Cell

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

LINES = 20
"""At most so many lines where there is no terminal to draw a bar on."""


class Measuring:
    """Tells how many of some cells are done, and how much time is left; `weight` says how much work each is."""

    def __init__(
        self, cells: Sequence[Cell], out: TextIO | None, weight: Callable[[Cell], float] = lambda cell: 1.0
    ) -> None:
        self.kept = self.measured = 0
        self.seconds = 0.0
        self._out, self._weight = out, weight
        self._count, self._work = len(cells), sum(map(weight, cells))
        self._done = self._left_out = 0.0
        self._now: Callable[[], int] = clock.RealClock().now
        self._began = self._now()

    def __enter__(self) -> Measuring:
        self._bar = self._make_bar() if self._out is not None and self._out.isatty() else None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.stop()

    def damaged(self, sentence: str) -> None:
        """Tell of an entry of a store that cannot be read."""
        sys.stderr.write(f"note: {sentence}\n")

    def finished(self, what: Finished) -> None:
        """Count a cell that is done, and tell."""
        self.seconds += what.seconds
        if what.kept:
            self.kept += 1
            self._left_out += self._weight(what.cell)
        else:
            self.measured += 1
            self._done += self._weight(what.cell)
        self._tell(what.kept)

    def left(self) -> float | None:
        """Return how long (s) the rest will take, by what was measured so far."""
        if not self._done:
            return None
        return (self._now() - self._began) / 1e9 * (self._work - self._left_out - self._done) / self._done

    def _tell(self, kept: bool) -> None:
        done = self.kept + self.measured
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done, said=self._said())
            self._bar.refresh()
        elif self._out and not kept and done * LINES // self._count > (done - 1) * LINES // self._count:
            self._out.write(f"{done} of {self._count}{self._said()}\n")
            self._out.flush()

    def _said(self) -> str:
        left = self.left()
        return "" if left is None else f", {in_words(left)} left"

    def _make_bar(self) -> Bar:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
        from rich.progress import Progress as Bar

        columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[said]}"))
        bar = Bar(*columns, console=Console(file=self._out), auto_refresh=False)
        bar.add_task("cells", total=self._count, said="")
        bar.start()
        return bar


def in_words(seconds: float) -> str:
    """Write a time as people say it: 45 s, 4 min 10 s, 3 h 5 min."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    hours, minutes_left = divmod(minutes, 60)
    larger, smaller = ((hours, "h"), (minutes_left, "min")) if hours else ((minutes, "min"), (rest, "s"))
    return " ".join(f"{number} {unit}" for number, unit in (larger, smaller) if number)


def processors() -> int:
    """Return how many processors this program may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
