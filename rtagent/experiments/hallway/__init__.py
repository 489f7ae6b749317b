"""Hallway-World (thesis, 3.2 and 3.3), which waits for the agent, or does not."""

from rtagent.experiments.experiment import Experiment
from rtagent.experiments.hallway.findings import find
from rtagent.experiments.hallway.runs import cells, measure, seconds

EXPERIMENT = Experiment(
    name="hallway",
    title="Hallway-World, synchronous and asynchronous: learning curves",
    thesis="Sections 3.2 and 3.3, figures 3.1 and 3.2",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(
        "The agent is a point that moves at a constant speed, without inertia; it knows only whether there is a "
        "wall on its left. The sizes of the hallway and its speed are ours: the thesis names none.",
        "The costs of components are constants that are charged to a virtual clock.",
    ),
)

__all__ = ["EXPERIMENT"]
