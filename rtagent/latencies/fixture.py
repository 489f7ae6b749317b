"""What a test gets as `rtagent_latency`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from rtagent.clock import ClockName
from rtagent.errors import SpecError, UndecidedError
from rtagent.latencies.allocations import allocations
from rtagent.latencies.baseline import read
from rtagent.latencies.comparison import Comparison, compare, to_floor, to_stored
from rtagent.latencies.counts import Counts
from rtagent.latencies.figures import timed, unmeasured
from rtagent.latencies.rounds import Rules
from rtagent.latencies.subject import Runs, Subject
from rtagent.latencies.system_calls import system_calls
from rtagent.latencies.times import Measured

What = Subject | str | Path


@dataclass
class Latency:
    """Runs scenarios and measures how long they take to react.

    Whatever is measured is a `Subject`, or the path of a scenario. Under the real clock it needs `may_measure`:
    the test is marked, and the session was asked for it. `told` gets a line for each thing that was measured.
    """

    rules: Rules = field(default_factory=Rules)
    may_measure: Callable[[], None] = lambda: None
    tell: Callable[[str], None] = lambda line: None

    def scenario(self, path: str | Path, *overrides: str) -> Subject:
        """Return a scenario with keys set over it, such as "schedule.preset=standard"; raises `ScenarioError`."""
        return Subject.scenario(path, *overrides)

    def of(self, runs: Runs, clock: ClockName, name: str = "") -> Subject:
        """Return what `runs` makes anew for each run: a coroutine such as `rtagent.run(…)`, under a clock."""
        return Subject.of(runs, clock, name)

    def run(self, what: What, *overrides: str) -> Measured:
        """Run it once and return its times; raises `RunError` where the run ended before its time."""
        subject = self._subject(what, overrides)
        return Measured(subject.run(), subject.name)

    def compare(self, before: What, after: What, *, quantile: float = 0.5) -> Comparison:
        """Return how many times as long things take `after`, by a quantile; real runs take turns, in rounds."""
        compared = compare(self._subject(before), self._subject(after), self.rules, quantile)
        return self._told(compared)

    def to_floor(self, what: What, *overrides: str, quantile: float = 0.5) -> Comparison:
        """Return how many bare wake-ups of this machine things take, by a quantile; both take turns, in rounds."""
        return self._told(to_floor(self._subject(what, overrides), self.rules, quantile))

    def to_baseline(self, what: What, file: str | Path, *overrides: str) -> Comparison:
        """Return how many times as long things take as in a baseline of `rtagent bench --save`: rounds of medians.

        Raises `BaselineError` where that has no figures of the same scenario, `UndecidedError` where they are of
        another machine.
        """
        subject, baseline = self._subject(what, overrides), read(Path(file))
        if subject.path is None or subject.clock != "real":
            raise SpecError(f"{subject.name} is no scenario under the real clock: baselines have times of those.")
        figures = unmeasured(subject.path, subject.overrides)
        stored = baseline.of(figures)
        if sentence := baseline.times_differ_by():
            raise UndecidedError(sentence)
        now = timed(figures, self.rules)
        return self._told(to_stored(str(file), subject.name, stored.times, now.times, self.rules))

    def allocations(self, what: What, *overrides: str) -> Counts:
        """Return the blocks of memory that each function takes in a cycle, under the virtual clock."""
        return allocations(self._subject(what, overrides))

    def system_calls(self, what: What, *overrides: str, episodes: int = 20) -> Counts:
        """Return the system calls of a scenario in a cycle, by name."""
        return system_calls(self._subject(what, overrides), episodes)

    def _subject(self, what: What, overrides: tuple[str, ...] = ()) -> Subject:
        if isinstance(what, Subject):
            subject = what.with_keys(*overrides) if overrides else what
        elif isinstance(what, str | Path):
            subject = Subject.scenario(what, *overrides)
        else:
            raise SpecError(f"{what!r} cannot be measured: give the path of a scenario, or what `of` returns.")
        if subject.clock == "real":
            self.may_measure()
        return subject

    def _told(self, comparison: Comparison) -> Comparison:
        for line in comparison.lines():
            self.tell(line)
        return comparison
