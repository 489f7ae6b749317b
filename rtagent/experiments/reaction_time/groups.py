"""All trials, by schedule and delay."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.reaction_time.trials import Trial

Group = tuple[str, float]
"""A schedule, and what learning takes (ms)."""
Groups = Mapping[Group, Sequence[Trial]]
Value = Callable[[Trial], float | None]


def groups_of(pairs: Sequence[tuple[Cell, Row]]) -> Groups:
    """Return the trials of each schedule and delay."""
    found: dict[Group, list[Trial]] = defaultdict(list)
    for cell, row in pairs:
        found[cell["schedule"], cell["delay_ms"]] += row["trials"]
    return dict(found)


def schedules(groups: Groups) -> list[str]:
    """Return the schedules, in the order in which they were measured."""
    return list(dict.fromkeys(schedule for schedule, _ in groups))


def delays(groups: Groups, *, above: float = -1) -> list[float]:
    """Return the delays (ms) above some, sorted."""
    return sorted({delay for _, delay in groups if delay > above})


def reward(trial: Trial) -> float | None:
    """Return the summed reward of a trial."""
    return float(trial["reward"])


def median(trial: Trial) -> float | None:
    """Return the median reaction time (ms) of a trial that has any."""
    return 1e3 * float(np.median(trial["reactions_s"])) if trial["reactions_s"] else None


def values(trials: Sequence[Trial], value: Value) -> list[float]:
    """Return a value of each trial that has it."""
    return [found for trial in trials if (found := value(trial)) is not None]


def alike(ours: Sequence[Trial], others: Sequence[Trial], value: Value) -> tuple[list[float], list[float]]:
    """Return a value of the trials that have the same seeds in both groups, where both have it."""
    seen = {trial["seed"]: value(trial) for trial in others}
    pairs = [(value(trial), seen.get(trial["seed"])) for trial in ours]
    both = [(first, second) for first, second in pairs if first is not None and second is not None]
    return [first for first, _ in both], [second for _, second in both]


def reactions(trials: Sequence[Trial]) -> list[float]:
    """Return all reaction times (ms)."""
    return [1e3 * time for trial in trials for time in trial["reactions_s"]]
