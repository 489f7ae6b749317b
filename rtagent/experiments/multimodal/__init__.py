"""Predictions from one kind of sensors, and from both (thesis, chapter 5; figures 5.6 to 5.9)."""

from rtagent.experiments.experiment import Experiment
from rtagent.experiments.multimodal import findings, measuring

EXPERIMENT = Experiment(
    name="multimodal",
    title="Predictions from colour, from position, and from both",
    thesis="Chapter 5, figures 5.6 to 5.9",
    cells=measuring.cells,
    measure=measuring.measure,
    find=findings.find,
    seconds=measuring.seconds,
    models=(
        "Hand, glove and camera are models of one grasping experiment: the course of a trial, the gesture table, "
        "the numbers of trials, the rates and the size of the picture are the thesis's.",
        "Where joints end, how exactly they do, how fast hands move, what is seen of object and thumb, light and "
        "noise are assumed (docs/grasping.md has each number).",
        "Both shapes cover the same part of the picture, as the thesis found mean colours to tell colours, not "
        "shapes. Where they do not, colour alone tells shapes, and verdicts against it change (docs/grasping.md).",
        "Not modelled: contact forces beyond the thumb's sensor, fingers that move others along, the camera's "
        "exposure and its pixels' noise, the glove's filter of 48 Hz, and mistakes of the experimenter.",
    ),
)
