"""Progress of a run: a bar on a terminal, a line now and then elsewhere; drawn only between episodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, TextIO

from rtagent.commands.check import device_notes
from rtagent.recorder import EpisodeRecord
from rtagent.units import describe

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from rtagent.realtime import Manners
    from rtagent.scenario import Assembly, Scenario

LINES = 20
"""At most so many lines where there is no terminal to draw a bar on."""


class Progress:
    """An instrument that tells how far the run is."""

    def __init__(self, scenario: Scenario, assembly: Assembly, granted: Manners, out: TextIO) -> None:
        run, plan = scenario.model.run, assembly.plan
        self._out, self._reacts = out, assembly.schedule.acts
        self._total, self._episodes = plan.trials * plan.episodes, plan.episodes
        self._done = self._steps = 0
        self._reactions: list[int] = []
        self._print(
            f"{scenario.name}: {plan.trials} × {plan.episodes} episodes, "
            f"{scenario.model.schedule.preset or 'custom'} order, {run.clock} clock, seed {run.seed}"
        )
        for note in device_notes(assembly):
            self._print(note)
        if granted.granted:
            self._print(f"real-time manners: {', '.join(granted.granted)}")
        self._bar = self._make_bar() if out.isatty() else None

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Draw the bar, or print a line."""
        self._done = record.trial * self._episodes + record.episode + 1
        self._steps += record.steps
        self._reactions += [reaction.time for reaction in record.reactions.reactions]
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self._done, said=self._said())
            self._bar.refresh()
        elif self._done * LINES // self._total > (self._done - 1) * LINES // self._total:
            self._print(f"episode {self._done} of {self._total}, {self._said()}")

    def close(self) -> None:
        """Leave the bar as it is."""
        if self._bar is not None:
            self._bar.stop()

    def _said(self) -> str:
        if not self._reacts:
            return f"{self._steps:,} steps"
        if not self._reactions:
            return "no reaction yet"
        return f"median reaction {describe(sorted(self._reactions)[len(self._reactions) // 2])}"

    def _print(self, line: str) -> None:
        self._out.write(line + "\n")
        self._out.flush()

    def _make_bar(self) -> Bar:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[said]}"),
        )
        bar = Bar(*columns, console=Console(file=self._out), auto_refresh=False)
        bar.add_task("episodes", total=self._total, said="")
        bar.start()
        return bar
