"""Tile coding against selective Kanerva coding on an arm that sorts (thesis, sections 4.3 and 4.4)."""

from __future__ import annotations

from rtagent.experiments.experiment import Cell, Experiment
from rtagent.experiments.representations.cells import cells, measure
from rtagent.experiments.representations.findings import find


def seconds(cell: Cell) -> float:
    """Return about how long a cell takes."""
    return 1.0


EXPERIMENT = Experiment(
    name="representations",
    title="Tile coding and selective Kanerva coding, with more and more dimensions",
    thesis="sections 4.3 and 4.4, figure 4.4, table 4.1",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(
        "The arm: point masses on the axes of shoulder, elbow and wrist, with gravity and the inertia of the motors; "
        "servos as motors with gearboxes, identified by others, under proportional control, with friction, lag and sag; "
        "heating by their currents; encoders with noise, and all readings in whole counts.",
        "Not the arm: elasticity, backlash and stiction of gears, contact with the table beyond that it bears the object, "
        "the supply's sag, and what the experimenter of the thesis did with the wrist, of which it says nothing: it is "
        "held.",
    ),
)
