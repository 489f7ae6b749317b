"""Tile coding against selective Kanerva coding on an arm that sorts (thesis, sections 4.3 and 4.4)."""

from __future__ import annotations

from rtagent.experiments.experiment import Cell, Experiment
from rtagent.experiments.representations.cells import cells, measure
from rtagent.experiments.representations.findings import find


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    usual = {"baseline": 1.2, "error": 0.3, "time": 0.2, "within": 1.0 if cell.get("quick") else 10.0}
    return usual[cell["kind"]] + 2e-5 * int(cell.get("prototypes", 0)) + 1.5e-3 * int(cell.get("tilings", 0))


EXPERIMENT = Experiment(
    name="representations",
    title="Tile coding and selective Kanerva coding, with more and more dimensions",
    thesis="sections 4.3 and 4.4, figure 4.4, table 4.1",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(
        "The arm is point masses on the axes of shoulder, elbow and wrist, with gravity and the inertia of the "
        "motors; servos are motors with gearboxes, as others identified them, under proportional control, with "
        "friction, lag and sag, heated by their currents; encoders have noise, and all is read in whole counts.",
        "Of elasticity, backlash and stiction, of contact with the table beyond that it bears the object, and of "
        "the supply's sag there is nothing in it. What was done with the wrist the thesis does not say: in one of "
        "our arms it is held, in another it keeps the hand level and turns the object.",
    ),
)
