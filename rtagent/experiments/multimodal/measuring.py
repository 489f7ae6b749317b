"""Cells of the multimodal predictions, and what is measured of each."""

from __future__ import annotations

from itertools import product

from rtagent.experiments.chunks import follow_chunks
from rtagent.experiments.experiment import Cell, Options, Row
from rtagent.experiments.grasping import (
    ALPHA,
    ETA,
    FINGERS,
    GAMMA,
    LAMBDA,
    SETTINGS,
    TRAINED,
    TRIALS,
    grasping,
    inputs,
)
from rtagent.experiments.multimodal.testing import Test
from rtagent.features import SelectiveKanerva
from rtagent.learning import TrueOnlineTD

PROTOTYPES = 8000
READINGS = {"α / c": True, "α": False}
"""How α = 0.01 is read: as the step size of all c active features together, or as that of each weight."""
SEEDS, QUICK_SEEDS = 20, 5


def cells(options: Options) -> list[Cell]:
    """Return a cell for each seed and each input setting."""
    seeds = range(QUICK_SEEDS if options.quick else SEEDS)
    return [
        {"setting": setting, "seed": seed, "trials": TRIALS, "prototypes": PROTOTYPES, "eta": ETA}
        for seed, setting in product(seeds, SETTINGS)
    ]


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return 0.5 + 0.045 * float(cell["trials"])


def measure(cell: Cell) -> Row:
    """Learn with one input setting and one seed, of the world and of the prototypes; return the errors."""
    stream, names = grasping(cell["trials"], cell["seed"]), inputs(cell["setting"])
    made = {"prototypes": cell["prototypes"], "eta": cell["eta"], "seed": cell["seed"]}
    coder = SelectiveKanerva(state=stream.state(names), **made)
    keys = list(product(READINGS, FINGERS))
    learners = {(reading, finger): _learner(coder, READINGS[reading]) for reading, finger in keys}
    cumulants = {key: (1.0 - GAMMA) * stream.unit(FINGERS[key[1]]) for key in keys}
    trained = round(TRAINED * len(stream))
    predicted = follow_chunks(stream.states(names), coder, learners, cumulants, trained)
    test, shown = Test(stream, trained), cell["seed"] == 0
    told = {
        reading: {finger: test.errors(finger, predicted[reading, finger], shown) for finger in FINGERS}
        for reading in READINGS
    }
    row = {"steps": len(stream), "active": coder.active, "readings": told}
    return row | {"sample": test.sample(SETTINGS[cell["setting"]])} if shown else row


def _learner(coder: SelectiveKanerva, divided: bool) -> TrueOnlineTD:
    return TrueOnlineTD(
        size=coder.size, active=coder.active, alpha=ALPHA, divide_alpha=divided, gamma=GAMMA, lambda_=LAMBDA
    )
