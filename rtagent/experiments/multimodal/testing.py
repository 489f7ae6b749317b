"""The test of predictions on the last part of the grasping stream, in which nothing is learned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experience import FloatArray
from rtagent.experiments.grasping import FINGERS, GAMMA
from rtagent.experiments.streams import Stream, returns

PLACES = 201
"""Of a distribution of errors so many quantiles are kept."""
WINDOWS = {"before": (1.8, 3.0), "during": (3.5, 6.0)}
"""Parts of a trial, in seconds since it began: the object is there and the hand open; the hand holds it."""
SHOWN, SAMPLE = 30, 45
"""What is drawn has so many points a second; a sample of the stream lasts so many seconds."""

Rows = NDArray[np.int64]


class Test:
    """The rows of a stream from `trained` on."""

    def __init__(self, stream: Stream, trained: int) -> None:
        self._stream, self._trained = stream, trained
        self._began = np.flatnonzero(np.diff(stream.column("button"), prepend=0.0) > 0.5)
        rows = np.arange(len(stream))
        trial = np.maximum(np.searchsorted(self._began, rows, side="right") - 1, 0)
        self._since: FloatArray = (rows - self._began[trial]) / stream.rate
        self._apart = max(1, round(stream.rate / SHOWN))

    def errors(self, finger: str, predicted: FloatArray, shown: bool) -> dict[str, Any] | None:
        """Return what is kept of the root squared errors of predictions, shape (rows,); None where they diverged.

        That is how many they are, their mean, variance and quantiles, their means within `WINDOWS`, and, where that
        is to be `shown`, what was predicted in a trial.
        """
        signal = self._stream.unit(FINGERS[finger])
        truth = returns(signal, self._stream.last, GAMMA)
        tested = np.flatnonzero(truth.known[self._trained :]) + self._trained
        found = np.abs(predicted - truth.values)[tested]
        if np.isnan(found).any():
            return None
        lines = {"signal": signal, "prediction": predicted, "return": truth.values}
        return {
            "count": len(found),
            "mean": float(found.mean()),
            "variance": float(found.var(ddof=1)),
            "quantiles": np.quantile(found, np.linspace(0.0, 1.0, PLACES)).tolist(),
            **self._windows(found, self._since[tested]),
            **({"trial": self._drawn(self._green_cylinder(tested[-1]), lines)} if shown else {}),
        }

    def sample(self, signals: Sequence[str]) -> dict[str, list[float]]:
        """Return some seconds of the stream, from the beginning of a trial of the test."""
        first = int(self._began[np.searchsorted(self._began, self._trained)])
        last = min(first + round(SAMPLE * self._stream.rate), len(self._stream))
        shown = (*signals, *FINGERS.values())
        return self._drawn((first, last), {name: self._stream.unit(name) for name in shown})

    def _windows(self, found: FloatArray, since: FloatArray) -> dict[str, float]:
        within = {name: (since >= first) & (since < end) for name, (first, end) in WINDOWS.items()}
        return {name: float(found[rows].mean()) for name, rows in within.items()}

    def _green_cylinder(self, last: int) -> tuple[int, int]:
        """Return the rows of the first trial, up to row `last`, in which the middle finger was put down."""
        began = self._began[(self._began >= self._trained) & (self._began < last)].tolist()
        middle, trials = self._stream.unit(FINGERS["middle"]), list(pairwise([*began, last]))
        return next((trial for trial in trials if middle[slice(*trial)].max() > 0.5), trials[0])

    def _drawn(self, rows: tuple[int, int], lines: Mapping[str, FloatArray]) -> dict[str, list[float]]:
        picked: Rows = np.arange(*rows, self._apart)
        times = (picked - rows[0]) / self._stream.rate
        return {"time": times.tolist()} | {name: values[picked].tolist() for name, values in lines.items()}
