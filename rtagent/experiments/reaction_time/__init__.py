"""Experiment 1 (thesis, 3.4.1): how the order of the components decides the time of reaction."""

from rtagent.experiments.experiment import Experiment
from rtagent.experiments.reaction_time.findings import find
from rtagent.experiments.reaction_time.trials import cells, measure, seconds

EXPERIMENT = Experiment(
    name="reaction-time",
    title="Experiment 1: stopping a joint, and what learning costs the reaction",
    thesis="Section 3.4.1, figure 3.4",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(
        "The joint turns at a constant velocity, its state is read as of now, and it stops the moment it is told "
        "to: inertia, and delays of a servo's own, are not modelled.",
        "The costs of components are constants that are charged to a virtual clock: what an operating system adds "
        "is not in them; `rtagent reproduce reaction-time-real` measures under the real clock.",
        "A unit of reward is a second spent in Emergency, but for one table; the thesis counts microseconds.",
    ),
)

__all__ = ["EXPERIMENT"]
