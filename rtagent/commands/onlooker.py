"""Who looks on while a run goes on: told how far it is, and what it came to; may stop hardware by a key."""

from __future__ import annotations

from collections.abc import Coroutine, Sequence
from typing import Any, TextIO

from rtagent.commands.progress import Progress
from rtagent.commands.report import print_report
from rtagent.latch import Latch
from rtagent.realtime import Manners
from rtagent.result import Result
from rtagent.scenario import Assembly, Scenario


class Onlooker:
    """Told on `out`, where it is not None, of a run with these manners."""

    def __init__(self, scenario: Scenario, assembly: Assembly, granted: Manners, out: TextIO | None) -> None:
        self._guarded, self._out = assembly.guarded, out
        self._progress = Progress(scenario, assembly, granted, out) if out is not None else None

    @property
    def instruments(self) -> Sequence[object]:
        """What goes with the run."""
        return [self._progress] if self._progress is not None else []

    def begin(self, latch: Latch, out: TextIO) -> bool:
        """Be there; say that the run may begin."""
        self._latch = latch
        return True

    def accompany(self, run: Coroutine[Any, Any, Result]) -> Coroutine[Any, Any, Result]:
        """Return the run, with keys that stop it where it moves something real."""
        if not self._guarded:
            return run
        from rtagent.commands.keyboard import with_keyboard  # needs what not every system that can run fakes has

        return with_keyboard(run, self._latch, self._out)

    def close(self) -> None:
        """Leave the progress as it is."""
        if self._progress is not None:
            self._progress.close()

    def tell(self, result: Result) -> None:
        """Print what it came to."""
        if self._out is not None:
            print_report(result, self._out)

    def as_dict(self) -> dict[str, Any]:
        """Return what is to be in the results beside those of the run: nothing."""
        return {}
