"""The figures of a scenario: times under the real clock, reactions under the virtual one, and counts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from typing import Any

from rtagent.errors import RtagentError, UndecidedError
from rtagent.latencies.allocations import allocations
from rtagent.latencies.comparison import Quantiles
from rtagent.latencies.counts import Counts
from rtagent.latencies.rounds import Block, Measure, Rules, Tell, floor, interleaved, of_subject
from rtagent.latencies.subject import Subject
from rtagent.latencies.system_calls import system_calls
from rtagent.result import Result
from rtagent.scenario import load
from rtagent.schedule import OBSERVE

VIRTUAL = "run.clock=virtual"
COUNTED_CYCLES = 2000
"""System calls are counted over so many cycles or more: what happens now and then is none of a cycle's."""

DRAWN = 1000
"""So many reaction times are kept, to draw."""

COUNTED: Mapping[str, Callable[[Subject, int], Counts]] = {
    "allocations": lambda subject, episodes: allocations(subject),
    "system calls": system_calls,
}
"""What is counted under the virtual clock, and how: in so many episodes."""


@dataclass(frozen=True)
class Exact:
    """What is the same in every run under the virtual clock: reaction times (ns), and counts by what is counted.

    What could not be had is missing, and a sentence in `notes` says why.
    """

    reactions: Sequence[int] = ()
    counts: Mapping[str, Counts] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Figures:
    """What was measured of a scenario, called `name`, from the file `path` with `keys` set over it.

    `scenario` is that with every default written out. `times` are medians (ns) of rounds under the real clock, and
    `reactions` some reaction times (ns) of those rounds; they are missing where `busy` says that the machine was.
    """

    name: str
    path: str
    keys: tuple[str, ...]
    scenario: Mapping[str, Any]
    exact: Exact = field(default_factory=Exact)
    times: Quantiles = field(default_factory=lambda: Quantiles({}, {}))
    reactions: Sequence[int] = ()
    busy: str = ""

    @property
    def digest(self) -> str:
        """What tells one resolved scenario from another."""
        return digest(self.scenario)


def digest(scenario: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a resolved scenario."""
    return hashlib.sha256(json.dumps(scenario, sort_keys=True).encode()).hexdigest()


def unmeasured(path: str | Path, keys: Sequence[str]) -> Figures:
    """Return a scenario of which nothing was measured; raises `ScenarioError` where it is none."""
    scenario = load(path, keys)
    Subject.scenario(path, *keys)
    resolved = json.loads(json.dumps(scenario.resolved()))
    return Figures(scenario.name, str(path), tuple(keys), resolved)


def is_real(figures: Figures) -> bool:
    """Say whether a scenario runs under the real clock."""
    return bool(figures.scenario["run"]["clock"] == "real")


def measured(figures: Figures, rules: Rules, tell: Tell = lambda line: None) -> Figures:
    """Return a scenario with all that can be measured of it; `tell` is told what is being done."""
    tell(f"{figures.name}: counting, under the virtual clock")
    figures = replace(figures, exact=exact(Subject.scenario(figures.path, *figures.keys)))
    if not is_real(figures):
        return figures
    try:
        return timed(figures, rules, lambda line: tell(f"{figures.name}: {line}"))
    except UndecidedError as error:
        return replace(figures, busy=str(error))


def timed(figures: Figures, rules: Rules, tell: Tell = lambda line: None) -> Figures:
    """Return a scenario with its times under the real clock, and bare wake-ups beside them.

    Raises `UndecidedError` where the machine was too busy.
    """
    subject = Subject.scenario(figures.path, *figures.keys)
    rounds = interleaved([Measure(floor), of_subject(subject)], rules, tell)
    wake_ups, blocks = ([each.blocks[side] for each in rounds.kept] for side in range(2))
    times = Quantiles.of(blocks).joined(Quantiles.of(wake_ups))
    return replace(figures, times=times, reactions=some_reactions(blocks))


def some_reactions(blocks: Sequence[Block]) -> list[int]:
    """Return the reaction times (ns) of some blocks, in order, or some of them where they are many."""
    times = sorted(time for block in blocks for time in block["reaction"])
    return times[:: max(1, -(-len(times) // DRAWN))]


def exact(subject: Subject) -> Exact:
    """Measure what a scenario has under the virtual clock."""
    try:
        virtual = subject.with_keys(VIRTUAL)
        result = virtual.run()
    except RtagentError as error:
        return Exact(notes=(f"it does not run under the virtual clock, where counts are taken: {error}",))
    counts, notes = {}, []
    for what, count in COUNTED.items():
        try:
            counts[what] = count(virtual, _episodes(result))
        except RtagentError as error:
            notes.append(f"{what} were not counted: {error}")
    return Exact(result.reaction_times, counts, tuple(notes))


def _episodes(result: Result) -> int:
    """Return how many episodes have enough cycles to count what happens in them."""
    cycles = result.recorder.components[OBSERVE].count
    return max(1, ceil(COUNTED_CYCLES * len(result.episodes) / max(1, cycles)))
