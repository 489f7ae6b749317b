"""What is measured: a scenario, or whatever runs an agent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rtagent import clock
from rtagent.clock import ClockName
from rtagent.errors import ClockError, SpecError
from rtagent.realtime import manners
from rtagent.result import Result
from rtagent.runtime import Habits
from rtagent.scenario import assemble, load

Runs = Callable[[], Coroutine[Any, Any, Result]]


@dataclass(frozen=True)
class Subject:
    """Something that can be run again and again, under its clock; `path` and `overrides` where it is a scenario."""

    name: str
    clock: ClockName
    run: Callable[[], Result]
    path: Path | None = None
    overrides: tuple[str, ...] = ()

    @classmethod
    def scenario(cls, path: str | Path, *overrides: str) -> Subject:
        """Return the scenario of a file, with keys set over it as by `--set`; raises `ScenarioError`."""
        model = load(path, overrides)
        assemble(model)  # so that all its problems are told now

        def run() -> Result:
            refuse_running_loop()
            assembly = assemble(model)
            with manners(assembly.realtime, model.model.run.clock, busy=assembly.never_sleeps) as granted:
                return granted.run(assembly.run([], Habits(granted.calm, granted.place_learner)))

        name = " ".join([model.name, *overrides])
        return cls(name, model.model.run.clock, run, Path(path), overrides)

    @classmethod
    def of(cls, runs: Runs, clock_name: ClockName, name: str = "") -> Subject:
        """Return what `runs` makes anew for each run: a coroutine such as `rtagent.run(…)`."""
        if clock_name not in ("real", "virtual"):
            raise SpecError(f"the clock {clock_name!r} is none: use 'real' or 'virtual'.")

        def run() -> Result:
            refuse_running_loop()
            return clock.run(runs(), clock_name)

        return cls(name or getattr(runs, "__name__", "the run"), clock_name, run)

    def called(self, name: str) -> Subject:
        """Return the same under another name."""
        return replace(self, name=name)

    def with_keys(self, *overrides: str) -> Subject:
        """Return the same scenario with further keys set; raises `SpecError` where it is none."""
        if self.path is None:
            raise SpecError(f"{self.name} is no scenario, and this needs one: give the path of a file.")
        return Subject.scenario(self.path, *self.overrides, *overrides)


def refuse_running_loop() -> None:
    """Refuse to measure within an event loop; raise `ClockError`."""
    if asyncio._get_running_loop() is not None:
        raise ClockError("an event loop is running already: measure in a test that is not async.")
