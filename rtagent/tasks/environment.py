"""The task of an environment that brings its own observation, reward and end, as those of Gymnasium do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import RewardMeter, require

OUTCOME = ("reward", "terminated", "truncated")


class EnvironmentTask:
    """Do what an environment rewards; its numbers are the state, its actions are numbered from 0.

    `calm` has ranges of signals: it is urgent while one of them is outside its own. Raises `SpecError` where a
    range is empty.
    """

    urgent: Callable[[Mapping[str, Sample]], bool]
    """Only there where `calm` says what is urgent (`rtagent.task.Urging`)."""

    def __init__(
        self, *, environment: str = "environment", calm: dict[str, tuple[float, float]] | None = None
    ) -> None:
        self._environment, self._calm = environment, calm or {}
        for name, (low, high) in self._calm.items():
            if not low <= high:
                raise SpecError(f"calm.{name} is [{low:g}, {high:g}]: give [lowest, highest].")
        if self._calm:
            self.urgent = self._outside_calm
        self.state: Mapping[str, Spec] = {}
        self.actions: Sequence[str] = ()
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Find the signals and the actions; raise `SpecError` where it is no environment."""
        require(devices, self._environment, OUTCOME, ("action",))
        spec = devices[self._environment]
        self.state = {name: each for name, each in spec.sensors.items() if name not in OUTCOME}
        for name in self._calm:
            if name not in self.state:
                raise SpecError(f"calm: the environment has no {name!r}{did_you_mean(name, list(self.state))}")
        self._names = tuple(self.state)
        self.actions = [str(action) for action in range(spec.actuators["action"].count)]
        self._commands = [{self._environment: {"action": action}} for action in range(len(self.actions))]

    def begin(self) -> None:
        """Begin an episode."""
        self._reward.begin()

    def interpret(self, observation: Observation) -> Outcome:
        """Return the state, what was earned since the last one, and the environment's own end."""
        values = observation.samples[self._environment].values
        state = tuple([float(values[name]) for name in self._names])
        reward = self._reward.since_last(values["reward"])
        terminated = bool(values["terminated"])  # which is the end, whether or not time is up as well
        return Outcome(state, reward, terminated, bool(values["truncated"]) and not terminated)

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return the command of an action."""
        return self._commands[action]

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say that nothing answers anything: an environment has no stimuli."""
        return False

    def save(self) -> Saved:
        """Return what was earned in the episode so far."""
        return self._reward.save()

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned in the middle of an episode."""
        self._reward.restore(saved)

    def _outside_calm(self, samples: Mapping[str, Sample]) -> bool:
        values = samples[self._environment].values
        return any(not low <= float(values[name]) <= high for name, (low, high) in self._calm.items())
