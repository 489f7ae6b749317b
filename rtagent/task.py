"""What a task is: it gives observations a meaning, and actions an effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from rtagent.errors import SpecError
from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec, Value


class Task(Protocol):
    """Turns observations into state, reward and termination, and actions into device commands.

    `state` names the signals of the state with their specs; `actions` names the actions (none in a task that
    only predicts).
    """

    @property
    def state(self) -> Mapping[str, Spec]:
        """The signals of the state, with their specs."""

    @property
    def actions(self) -> Sequence[str]:
        """The names of the actions."""

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Check, before a run, that the devices have what the task needs; raise `SpecError`."""

    def begin(self) -> None:
        """Begin an episode: forget the last one."""

    def interpret(self, observation: Observation) -> Outcome:
        """Return the state, the reward since the last call, and whether the episode ends."""

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return the command for each device, by its name, that carries out `action`."""

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say whether `action` is the correct answer to `stimulus` (for the response time)."""


@runtime_checkable
class Urging(Protocol):
    """A task that says which states are urgent, so that learning waits for calmer ones."""

    def urgent(self, samples: Mapping[str, Sample]) -> bool:
        """Say whether the world is in an urgent state; `samples` are the newest by the names of their devices."""


def require(
    devices: Mapping[str, DeviceSpec], device: str, sensors: Sequence[str], actuators: Sequence[str]
) -> None:
    """Raise `SpecError` unless `device` is there with these sensors and actuators."""
    if device not in devices:
        there = ", ".join(devices) or "none"
        raise SpecError(f"the task needs a device named {device!r}; the scenario has {there}.")
    spec = devices[device]
    for kind, needed, has in (("sensor", sensors, spec.sensors), ("actuator", actuators, spec.actuators)):
        for name in needed:
            if name not in has:
                there = ", ".join(has) or "none"
                raise SpecError(f"the task needs the {kind} {name!r} of device {device!r}, which has {there}.")


class RewardMeter:
    """Turns a reward that a world sums up since the episode began into rewards since the last look.

    Nothing of it is lost or counted twice when samples are.
    """

    def __init__(self) -> None:
        self._seen = 0.0

    def begin(self) -> None:
        """Begin an episode, in which nothing was earned yet."""
        self._seen = 0.0

    def since_last(self, total: Value) -> float:
        """Return what was earned since the last call."""
        reward = float(total) - self._seen
        self._seen = float(total)
        return reward

    def save(self) -> Saved:
        """Return what was earned so far."""
        return save_fields(self, ("_seen",))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_fields(self, ("_seen",), saved)
