"""The numbers of Experiment 1."""

from __future__ import annotations

import numpy as np

from rtagent.experiments.experiment import Table
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
