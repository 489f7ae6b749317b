"""Predictions from one kind of sensors and from both (thesis, chapter 5; figures 5.6 to 5.9)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FloatArray
from rtagent.experiments import multimodal_findings
from rtagent.experiments.experiment import Cell, Experiment, Options, Row
from rtagent.experiments.grasping import FINGERS, SETTINGS, TRIALS, Stream, grasping, inputs, returns
from rtagent.experiments.learned import tested
from rtagent.features import SelectiveKanerva
from rtagent.learning import TrueOnlineTD
from rtagent.specs import Spec

GAMMA, LAMBDA, ALPHA, ETA, PROTOTYPES, TRAINED = 0.999, 0.9, 0.01, 0.025, 8000, 0.8
READINGS = {"α / c": True, "α": False}
"""How α = 0.01 is read: as the step size of all active features together, or as that of each weight."""
UNKNOWN = 1e-3
"""The weight, in a return, of what comes after the end of the stream, above which it is not compared."""
SEEDS, QUICK_SEEDS, QUICK_TRIALS = 10, 5, 44
SHOWN = 30
"""The stream of the first seed is drawn with so many points a second."""
PLACES = 201
"""Of a distribution of errors so many quantiles are kept."""
WINDOWS = {"before": (1.8, 3.0), "during": (3.5, 6.0)}
"""Parts of a trial, in seconds since it began: the object is there and the hand open; the hand holds it."""


def cells(options: Options) -> list[Cell]:
    """Return a cell for each seed and each input setting."""
    seeds, trials = (QUICK_SEEDS, QUICK_TRIALS) if options.quick else (SEEDS, TRIALS)
    return [
        {"setting": setting, "seed": seed, "trials": trials, "prototypes": PROTOTYPES, "eta": ETA}
        for seed, setting in product(range(seeds), SETTINGS)
    ]


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return 1.0 + 0.1 * float(cell["trials"])


def measure(cell: Cell) -> Row:
    """Learn with one input setting and one seed, of the world and of the prototypes; return the errors."""
    stream = grasping(cell["trials"], cell["seed"])
    states, trained = inputs(stream, SETTINGS[cell["setting"]]), round(TRAINED * len(stream.times))
    coder = SelectiveKanerva(
        state=dict.fromkeys(map(str, range(states.shape[1])), Spec(low=0.0, high=1.0)),
        prototypes=cell["prototypes"],
        eta=cell["eta"],
        seed=cell["seed"],
    )
    row: dict[str, Any] = {"steps": len(states), "active": coder.active, "readings": {}}
    for reading, divided in READINGS.items():
        row["readings"][reading] = _learned(stream, states, coder, divided, trained, cell["seed"] == 0)
    if cell["seed"] == 0:
        row["sample"] = _sample(stream, SETTINGS[cell["setting"]], trained)
    return row


def _learned(
    stream: Stream, states: FloatArray, coder: SelectiveKanerva, divided: bool, trained: int, shown: bool
) -> dict[str, Any]:
    """Return, by finger, the errors of one reading of α; None where learning diverged."""
    common = {"size": coder.size, "active": coder.active, "gamma": GAMMA, "lambda_": LAMBDA}
    learners = {finger: TrueOnlineTD(alpha=ALPHA, divide_alpha=divided, **common) for finger in FINGERS}
    targets = {finger: stream.signals[signal] for finger, signal in FINGERS.items()}
    rewards = {finger: (1.0 - GAMMA) * target for finger, target in targets.items()}
    try:
        predicted = tested(coder, states, learners, rewards, trained)
    except SpecError:
        return dict.fromkeys(FINGERS)
    known = len(states) - trained - int(np.ceil(np.log(UNKNOWN) / np.log(GAMMA)))
    found: dict[str, Any] = {}
    for finger, target in targets.items():
        truth, said = returns(target, GAMMA)[trained:][:known], predicted[finger][:known]
        found[finger] = errors(np.abs(said - truth)) | windows(stream, said, truth, trained)
        if shown:
            found[finger]["trial"] = _trial(stream, said, truth, target[trained:], trained)
    return found


def errors(found: FloatArray) -> dict[str, Any]:
    """Return what is kept of root squared errors: how many, their mean and variance, and their quantiles."""
    return {
        "count": len(found),
        "mean": float(found.mean()),
        "variance": float(found.var(ddof=1)),
        "quantiles": np.quantile(found, np.linspace(0.0, 1.0, PLACES)).tolist(),
    }


def windows(stream: Stream, said: FloatArray, truth: FloatArray, trained: int) -> dict[str, float]:
    """Return the mean error within each of `WINDOWS`, over all trials."""
    found = np.abs(said - truth)
    since = _since(stream)[trained:][: len(found)]
    return {name: float(found[(since >= first) & (since < last)].mean()) for name, (first, last) in WINDOWS.items()}


def _since(stream: Stream) -> FloatArray:
    """Return for each row how long ago, in seconds, its trial began."""
    rows = np.arange(len(stream.times))
    trial = np.maximum(np.searchsorted(stream.began, rows, side="right") - 1, 0)
    since: FloatArray = (stream.times - stream.times[stream.began[trial]]) / 1e9
    return since


def _trial(
    stream: Stream, said: FloatArray, truth: FloatArray, signal: FloatArray, trained: int
) -> dict[str, list[float]]:
    """Return a trial of the test in which the middle finger was put down: that of the green cylinder."""
    rows = _green_cylinder(stream, trained, len(said))
    since = _since(stream)[trained:][rows]
    parts = {"time": since, "prediction": said[rows], "return": truth[rows], "signal": signal[rows]}
    return {name: values.tolist() for name, values in parts.items()}


def _green_cylinder(stream: Stream, trained: int, known: int) -> NDArray[np.int64]:
    """Return rows of the test, `SHOWN` a second, of its first whole trial with the green cylinder."""
    began = stream.began[(stream.began >= trained)] - trained
    whole = [(first, last) for first, last in pairwise(began.tolist()) if last <= known]
    middle = stream.signals[FINGERS["middle"]][trained:]
    first, last = next((each for each in whole if middle[slice(*each)].max() > 0.5), whole[0])
    return np.arange(first, last, _apart(stream))


def _apart(stream: Stream) -> int:
    return max(1, round(1e9 / SHOWN / float(np.median(np.diff(stream.times)))))


def _sample(stream: Stream, signals: Sequence[str], trained: int) -> dict[str, list[float]]:
    """Return some 45 seconds of the stream, from the beginning of a trial of the test: figure 5.6."""
    first = int(stream.began[np.searchsorted(stream.began, trained)])
    rows = np.arange(first, len(stream.times), _apart(stream))
    rows = rows[stream.times[rows] < stream.times[first] + 45e9]
    shown: Mapping[str, FloatArray] = {name: stream.signals[name][rows] for name in (*signals, *FINGERS.values())}
    times = (stream.times[rows] - stream.times[first]) / 1e9
    return {"time": times.tolist()} | {name: values.tolist() for name, values in shown.items()}


EXPERIMENT = Experiment(
    name="multimodal",
    title="Predictions from colour, from position, and from both",
    thesis="chapter 5, figures 5.6 to 5.9",
    cells=cells,
    measure=measure,
    find=multimodal_findings.find,
    seconds=seconds,
    models=(
        "The hand, the glove and the camera are models of one grasping experiment: the course of a trial, the gesture "
        "table, the numbers of trials, the rates and the image size are the thesis's.",
        "Where joints end, how exactly they do, how fast hands move, what is seen of object and thumb, light and "
        "noise are assumed (docs/grasping.md has each number); both shapes cover the same part of the picture.",
        "Not modelled: contact forces beyond the thumb's sensor, fingers that move others along, the camera's "
        "exposure and its pixels' noise, the glove's filter of 48 Hz, and mistakes of the experimenter.",
    ),
)
