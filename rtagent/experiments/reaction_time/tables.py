"""The numbers of Experiment 1."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtagent.experiments.experiment import Cell, Row, Table
from rtagent.experiments.reaction_time.groups import Groups, median, reactions, reward, values
from rtagent.experiments.statistics import interval


def table(groups: Groups) -> Table:
    """Return a row for each schedule and delay."""
    head = ("schedule", "delay", "trials", "summed reward", "median reaction", "9 of 10 within", "missed")
    rows = [
        (
            schedule,
            f"{delay:g} ms",
            str(len(trials)),
            str(interval(values(trials, reward))),
            f"{interval(values(trials, median), np.median)} ms" if reactions(trials) else "",
            f"{np.quantile(reactions(trials), 0.9):.3g} ms" if reactions(trials) else "",
            str(sum(trial["missed"] for trial in trials)),
        )
        for (schedule, delay), trials in groups.items()
    ]
    return Table("Means of trials, or medians of their medians, with 95 % intervals.", head, tuple(rows))


def literal_table(pairs: Sequence[tuple[Cell, Row]]) -> Table:
    """Return what became of Emergencies where a unit of reward is a microsecond, as printed.

    A needless stop then costs as much as a microsecond in Emergency: next to nothing.
    """
    head = ("schedule", "delay", "answered before they were seen", "answered after", "missed")
    rows = tuple((cell["schedule"], f"{cell['delay_ms']:g} ms", *_answers(row)) for cell, row in pairs)
    caption = (
        "Emergencies of the last episodes where rewards count microseconds, as the thesis prints: a needless stop "
        "costs as much as one of them. Who stops all the time answers before anything is seen."
    )
    return Table(caption, head, rows)


def _answers(row: Row) -> tuple[str, str, str]:
    trials = row["trials"]
    after = sum(len(trial["responses_s"]) for trial in trials)
    return (
        str(sum(trial["anticipated"] for trial in trials)),
        str(after),
        str(sum(each["missed"] for each in trials)),
    )
