"""A task that only observes: the signals of the devices are its state, for demons to predict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import Command, Observation, Outcome, Stimulus
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec
from rtagent.tasks.sensors import Readings, Sensor, numbers_sensed, picked

ENDED = "ended"
"""A sensor of this name, true or false, says that a device has no more to come."""


class Signals:
    """Observe signals and do nothing; an episode is truncated when a device has ended.

    `signals` are names, `device.sensor`, or patterns such as `"arm.*_position"`; without them every number that is
    sensed is a signal. `reward` names the `device.sensor` whose value is the reward at each observation. A signal
    is called as its sensor is, or `device.sensor` where several devices have one of that name. The state is known
    once `bind` was called.
    """

    actions: Sequence[str] = ()

    def __init__(self, *, signals: tuple[str, ...] = (), reward: str = "") -> None:
        self._patterns, self._reward_path = signals, reward
        self.state: Mapping[str, Spec] = {}

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Find the signals; raise `SpecError` where a pattern fits none, or there are none."""
        there = numbers_sensed(devices)
        self._readings = Readings(self._chosen(there))
        reward = self._the_reward(there)
        self.state = self._readings.specs
        self._reward = None if reward is None else (reward.device, reward.name)
        self._ends = [sensor.device for sensor in there if _is_end(sensor)]

    def begin(self) -> None:
        """Begin an episode: nothing is to be forgotten."""

    def interpret(self, observation: Observation) -> Outcome:
        """Return the signals as they are; the episode is truncated when a device has ended."""
        samples = observation.samples
        reward = float(samples[self._reward[0]].values[self._reward[1]]) if self._reward else 0.0
        ended = any(samples[device].values[ENDED] for device in self._ends)
        return Outcome(self._readings(observation), reward, terminated=False, truncated=ended)

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return nothing: it has no actions."""
        return {}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say that nothing answers anything."""
        return False

    def save(self) -> Saved:
        """Return nothing: it remembers nothing."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""

    def _chosen(self, there: Sequence[Sensor]) -> list[Sensor]:
        usable = [sensor for sensor in there if not _is_end(sensor)]
        if self._patterns:
            return picked(self._patterns, usable)
        numbers = [sensor for sensor in usable if sensor.spec.dtype != "bool"]
        if not numbers:
            raise SpecError("no device senses a number that could be a signal; it needs a sensor of shape ().")
        return numbers

    def _the_reward(self, there: Sequence[Sensor]) -> Sensor | None:
        if not self._reward_path:
            return None
        paths = {each.path: each for each in there}
        if self._reward_path not in paths:
            hint = did_you_mean(self._reward_path, list(paths))
            raise SpecError(f"reward is {self._reward_path!r}, which is no device.sensor{hint}")
        return paths[self._reward_path]


def _is_end(sensor: Sensor) -> bool:
    return sensor.name == ENDED and sensor.spec.dtype == "bool"
