"""The task of an environment that brings its own observation, reward and end, as those of Gymnasium do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.experience import Command, Observation, Outcome, Stimulus
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import RewardMeter, require

OUTCOME = ("reward", "terminated", "truncated")


class EnvironmentTask:
    """Do what an environment rewards; its numbers are the state, its actions are numbered from 0."""

    def __init__(self, *, environment: str = "environment") -> None:
        self._environment = environment
        self.state: Mapping[str, Spec] = {}
        self.actions: Sequence[str] = ()
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Find the signals and the actions; raise `SpecError` where it is no environment."""
        require(devices, self._environment, OUTCOME, ("action",))
        spec = devices[self._environment]
        self.state = {name: each for name, each in spec.sensors.items() if name not in OUTCOME}
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
