"""Flags that follow from a device's signals, and stimuli where they turn true."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import Sample, Stimulus
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec


@dataclass(frozen=True)
class Event:
    """A signal above or below a value; it is over only when the signal is back within it by `hysteresis`.

    Raises `SpecError` without a value, or where `hysteresis` is negative.
    """

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    signal: str
    above: float = math.inf
    below: float = -math.inf
    hysteresis: float = 0.0

    def __post_init__(self) -> None:
        if math.isinf(self.above) and math.isinf(self.below):
            raise SpecError("an event has no bound: give above or below a value.")
        if not 0.0 <= self.hysteresis < math.inf:
            raise SpecError(f"an event's hysteresis is {self.hysteresis}: give 0 or more, in the signal's unit.")

    def holds(self, value: float, held: bool) -> bool:
        """Say whether it is so at `value`, if it `held` before or not."""
        slack = self.hysteresis if held else 0.0
        return value > self.above - slack or value < self.below + slack


class Flags:
    """The events of one device, by the names of their flags.

    Raises `SpecError` for an event of a signal that is not there or no single number, or named as a sensor is.
    """

    def __init__(self, events: Mapping[str, Event], spec: DeviceSpec) -> None:
        for name, event in events.items():
            _check(name, event, spec)
        self._events = events
        self.spec = replace(spec, sensors={**spec.sensors, **dict.fromkeys(events, Spec.flag())})
        self.begin()

    def begin(self) -> None:
        """Begin an episode: what is so at first has not happened in it."""
        self._held: dict[str, bool] | None = None
        self._stimuli: list[Stimulus] = []

    def __call__(self, sample: Sample) -> Sample:
        """Return a sample with the flags; each that turned true since the last one is a stimulus of its time."""
        held = self._held or {}
        now = {
            name: event.holds(float(sample.values[event.signal]), held.get(name, False))
            for name, event in self._events.items()
        }
        if self._held is not None:
            self._stimuli += [
                Stimulus(sample.world_time, name, sample.time_source)
                for name in now
                if now[name] and not held[name]
            ]
        self._held = now
        return sample._replace(values={**sample.values, **now})

    def save(self) -> Saved:
        """Return which hold, and the stimuli of the episode."""
        return {
            "held": None if self._held is None else dict(self._held),
            "stimuli": [list(each) for each in self._stimuli],
        }

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        self._held, self._stimuli = saved["held"], [Stimulus(*each) for each in saved["stimuli"]]

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the stimuli with after < time <= until (ns), in order."""
        return [stimulus for stimulus in self._stimuli if after < stimulus.time <= until]


def _check(name: str, event: Event, spec: DeviceSpec) -> None:
    if name in spec.sensors:
        raise SpecError(f"the event {name!r} is called as a sensor is: give it another name.")
    numbers = [sensor for sensor, each in spec.sensors.items() if each.shape == ()]
    if event.signal not in numbers:
        hint = did_you_mean(event.signal, numbers)
        raise SpecError(f"the event {name!r} is of {event.signal!r}, which is no number that is sensed{hint}")
