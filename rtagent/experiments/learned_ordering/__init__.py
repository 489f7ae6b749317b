"""An agent that learns its own ordering (thesis, 6.3.1), against every fixed preset, where time is scarce."""

from rtagent.experiments.experiment import Experiment
from rtagent.experiments.learned_ordering.findings import find
from rtagent.experiments.learned_ordering.runs import cells, measure, seconds

EXPERIMENT = Experiment(
    name="learned-ordering",
    title="An agent that learns its own ordering, in worlds with calm and urgent phases",
    thesis="Section 6.3.1, optimal algorithm ordering; it has no figure",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(
        "The switchboard is a toy: one call rings at a time, is for one outlet, and earns what is left of its "
        "patience. When calls come does not depend on how earlier ones were answered.",
        "Components cost constants on one virtual processor, learning the same for each transition, in slices of "
        "any length. The decision what comes next costs 50 µs; waiting, and asking whether a new sample has come, "
        "cost nothing.",
        "background learns on a second virtual processor, which the others do not have.",
    ),
)

__all__ = ["EXPERIMENT"]
