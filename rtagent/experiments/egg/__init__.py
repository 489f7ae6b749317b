"""Experiment 2 of the thesis (section 3.4.2): a person and an agent stop an arm before it crushes an egg."""

from __future__ import annotations

from rtagent.experiments.egg.findings import find
from rtagent.experiments.egg.trial import measure
from rtagent.experiments.egg.variants import cells, seconds
from rtagent.experiments.experiment import Experiment

EXPERIMENT = Experiment(
    "egg",
    "Stopping before an egg",
    "Experiment 2 (3.4.2), figures 3.5 and 3.6",
    cells,
    measure,
    find,
    seconds,
    (
        "The arm is one joint with a constant acceleration to its speed and to rest. Neither play, nor the weight "
        "of the arm, nor what an egg does to it, nor sampling is modelled.",
        "The people are a model from the literature on timing, whose parameters were set before the first trial: "
        "they anticipate with a normally distributed error, leave the margin that gains most with it, and correct "
        "a fifth of the error that they see. They do not tire, are not distracted, and guess no algorithm.",
        "Learning takes 50 ms a step in every condition, as in the thesis; nothing else takes time.",
    ),
)
