"""The stream of the grasping experiment (thesis, chapter 5): three devices, merged by their newest samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.device import Device
from rtagent.errors import SpecError
from rtagent.experience import FloatArray
from rtagent.experiments.scenarios import scenario
from rtagent.scenario import assemble, load
from rtagent.streams import stream
from rtagent.units import second

TRIAL = 9 * second
TRIALS = 131
"""31 with the green cylinder, 33 with each stepped one, 34 with the orange cylinder."""

COLOR, POSITION = ("red", "green"), ("index_intermediate", "ring_proximal")
SETTINGS: Mapping[str, tuple[str, ...]] = {
    "Color only": COLOR,
    "Position only": POSITION,
    "All": COLOR + POSITION,
}
FINGERS: Mapping[str, str] = {"middle": "middle_bend", "ring": "ring_bend", "pinky": "pinky_bend"}
DECAY = 0.999
"""Of the data traces."""

Times = NDArray[np.int64]


@runtime_checkable
class Foretelling(Protocol):
    """A device that knows beforehand what it will sense, as fakes in the process do."""

    def foretold(self, rng: Generator, length: int) -> tuple[Times, Mapping[str, FloatArray]]:
        """Return all samples that arrive in an episode of `length` (ns): when each arrives, and the values."""


@dataclass(frozen=True)
class Stream:
    """Signals that were observed together at these `times` (ns), shape (n,), and in which rows a trial began."""

    times: Times
    signals: Mapping[str, FloatArray]
    began: NDArray[np.int64]


def grasping(trials: int, seed: int) -> Stream:
    """Return what a run of the scenario `grasping` would observe at each sample of the glove, normalised.

    Every signal lies between 0 and 1, its least and its greatest value in all of the stream.
    """
    devices = assemble(load(scenario("grasping"), ["run.fake=process", "run.clock=virtual"])).devices
    times, signals = merged(devices, "glove", trials * TRIAL, seed)
    pressed = np.diff(signals["button"], prepend=0.0) > 0.5
    return Stream(times, {name: normalised(values) for name, values in signals.items()}, np.flatnonzero(pressed))


def merged(
    devices: Mapping[str, Device], pace: str, length: int, seed: int
) -> tuple[Times, Mapping[str, FloatArray]]:
    """Return the newest values of all devices at each sample of the device `pace`, from when each has one."""
    told = {name: _foretold(device, name, length, seed) for name, device in devices.items()}
    times = told[pace][0]
    times = times[times >= max(each[0][0] for each in told.values())]
    signals: dict[str, FloatArray] = {}
    for arrivals, columns in told.values():
        newest = np.searchsorted(arrivals, times, side="right") - 1
        signals |= {name: values[newest] for name, values in columns.items()}
    return times, signals


def _foretold(device: Device, name: str, length: int, seed: int) -> tuple[Times, Mapping[str, FloatArray]]:
    if not isinstance(device, Foretelling):
        raise SpecError(f"what {name} will sense is not known beforehand: this needs fakes in the process.")
    return device.foretold(stream(seed, "device", name, 0, 0), length)


def inputs(made: Stream, signals: Sequence[str]) -> FloatArray:
    """Return the signals and their normalised traces, shape (n, 2 · signals): points of the unit cube."""
    columns = [made.signals[name] for name in signals]
    return np.stack(columns + [normalised(traced(column, DECAY)) for column in columns], axis=1)


def normalised(values: FloatArray) -> FloatArray:
    """Return values between 0, the least of them, and 1, the greatest; all 0 where they are the same."""
    low, high = float(values.min()), float(values.max())
    return (values - low) / (high - low) if high > low else np.zeros_like(values)


def traced(values: FloatArray, decay: float) -> FloatArray:
    """Return the data trace T ← T · decay + S after each value."""
    return _array(accumulate(values.tolist(), lambda trace, value: trace * decay + value))


def returns(values: FloatArray, gamma: float) -> FloatArray:
    """Return the normalised return of each value, itself included: (1 - γ) Σ γᵏ z(t + k), up to the last."""
    backwards = ((1.0 - gamma) * values[::-1]).tolist()
    return _array(accumulate(backwards, lambda later, value: later * gamma + value))[::-1]


def _array(values: Iterable[float]) -> FloatArray:
    return np.fromiter(values, float)
