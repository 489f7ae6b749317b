"""All trials, by schedule and delay."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.reaction_time.trials import Trial

Group = tuple[str, float]
"""A schedule, and what learning takes (ms)."""
Groups = Mapping[Group, Sequence[Trial]]


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


def rewards(trials: Sequence[Trial]) -> list[float]:
    """Return the summed reward of each trial."""
    return [trial["reward"] for trial in trials]


def medians(trials: Sequence[Trial]) -> list[float]:
    """Return the median reaction time (ms) of each trial that has any."""
    return [1e3 * float(np.median(trial["reactions_s"])) for trial in trials if trial["reactions_s"]]


def both(ours: Sequence[Trial], others: Sequence[Trial]) -> tuple[list[float], list[float]]:
    """Return the median reactions (ms) of trials with the same seeds, where both have any."""
    seen = {trial["seed"]: trial for trial in others if trial["reactions_s"]}
    alike = [(trial, seen[trial["seed"]]) for trial in ours if trial["reactions_s"] and trial["seed"] in seen]
    return medians([first for first, _ in alike]), medians([second for _, second in alike])


def reactions(trials: Sequence[Trial]) -> list[float]:
    """Return all reaction times (ms)."""
    return [1e3 * time for trial in trials for time in trial["reactions_s"]]
