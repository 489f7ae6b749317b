"""The stream of the grasping experiment: its three devices, merged by their newest samples (thesis, 5.2.1)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from rtagent.device import Device
from rtagent.errors import SpecError
from rtagent.experience import FloatArray
from rtagent.experiments.scenarios import scenario
from rtagent.experiments.streams import Stream, seen_ranges
from rtagent.scenario import assemble, load
from rtagent.streams import stream
from rtagent_drivers.fake import FakeDevice
from rtagent_drivers.grasping.session import TRIAL, Times

PACE = "glove"
"""The device that is sampled most often."""


@lru_cache(maxsize=1)
def grasping(*, trials: int = 131, seed: int = 0) -> Stream:
    """Return what a run of `scenarios/grasping.toml` with this seed observes at each sample of the glove.

    A signal ranges from its least to its greatest value in the stream; the `button` is down where a trial begins.
    """
    devices = assemble(load(scenario("grasping"), ["run.fake=process", "run.clock=virtual"])).devices
    times, columns = merged(devices, PACE, trials * TRIAL, seed)
    last = np.zeros(len(times), dtype=np.bool_)
    last[-1] = True
    rate = devices[PACE].spec.rate
    told = f"the simulated grasping experiment: {trials} trials, {len(times):,} rows at {rate:g} Hz"
    return Stream(columns, seen_ranges(columns), last, rate, told)


def merged(devices: Mapping[str, Device], pace: str, length: int, seed: int) -> tuple[Times, dict[str, FloatArray]]:
    """Return the newest values of all devices when each sample of one, `pace`, arrives; from when each has one.

    Raises `SpecError` for a device that is no fake in the process, and for sensors of the same name.
    """
    told = {}
    for name, device in devices.items():
        if not isinstance(device, FakeDevice):
            raise SpecError(f"what {name} will sense is not known beforehand: take fakes in the process.")
        told[name] = device.foretold(stream(seed, "device", name, 0, 0), length)
    times = told[pace][0]
    times = times[times >= max(arrivals[0] for arrivals, _ in told.values())]
    columns: dict[str, FloatArray] = {}
    for arrivals, values in told.values():
        newest = np.searchsorted(arrivals, times, side="right") - 1
        if double := columns.keys() & values.keys():
            raise SpecError(f"two devices sense something called {min(double)!r}: name one otherwise.")
        columns |= {name: column[newest] for name, column in values.items()}
    return times, columns
