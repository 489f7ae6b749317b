"""Sensors of devices as signals of a state: those that patterns pick, what they are called, and their values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from rtagent.experience import Observation
from rtagent.features.inputs import matching
from rtagent.specs import DeviceSpec, Spec


class Sensor(NamedTuple):
    """A sensor of a device."""

    device: str
    name: str
    spec: Spec

    @property
    def path(self) -> str:
        """What patterns are matched with: `device.sensor`."""
        return f"{self.device}.{self.name}"


def numbers_sensed(devices: Mapping[str, DeviceSpec]) -> list[Sensor]:
    """Return the sensors of all devices that sense a single number, in their order."""
    return [
        Sensor(device, name, sensor)
        for device, spec in devices.items()
        for name, sensor in spec.sensors.items()
        if sensor.shape == ()
    ]


def picked(patterns: Sequence[str], there: Sequence[Sensor]) -> list[Sensor]:
    """Return the sensors that match any of the patterns; raise `SpecError` for a pattern that matches none."""
    by_path = {sensor.path: sensor for sensor in there}
    return [by_path[path] for path in matching(patterns, by_path)]


class Readings:
    """Reads sensors as signals, whose names and specs are `specs`.

    A signal is called as its sensor is, or `device.sensor` where that name is `taken` or several devices have one
    of it.
    """

    def __init__(self, sensors: Sequence[Sensor], taken: Collection[str] = ()) -> None:
        count = Counter([sensor.name for sensor in sensors]) + Counter(taken)
        self.specs: dict[str, Spec] = {
            sensor.name if count[sensor.name] == 1 else sensor.path: sensor.spec for sensor in sensors
        }
        self._places = [(sensor.device, sensor.name) for sensor in sensors]

    def __call__(self, observation: Observation) -> tuple[float, ...]:
        """Return the newest values, one for each of `specs`."""
        samples = observation.samples
        return tuple([float(samples[device].values[name]) for device, name in self._places])
