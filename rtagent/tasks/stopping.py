"""The stopping task (thesis, section 3.4): stop the joint as soon as Normal turns to Emergency."""

from __future__ import annotations

from collections.abc import Mapping

from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import RewardMeter, require

MOVE, STOP = 0, 1


class Stopping:
    """Stop a joint when its state changes from Normal to Emergency (thesis, Experiment 1)."""

    actions = ("move", "stop")

    def __init__(self, *, joint: str = "joint") -> None:
        self._joint = joint
        self.state = {"emergency": Spec.flag()}
        self._commands: tuple[Mapping[str, Command], ...] = tuple(
            {joint: {"motion": action}} for action in (MOVE, STOP)
        )
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Check that the joint is there; raise `SpecError`."""
        require(devices, self._joint, ("emergency", "stopped", "at_end", "reward"), ("motion",))

    def begin(self) -> None:
        """Begin an episode."""
        self._reward.begin()

    def interpret(self, observation: Observation) -> Outcome:
        """Return whether it is an Emergency; the episode ends with the joint at rest."""
        values = observation.samples[self._joint].values
        over = bool(values["stopped"] or values["at_end"])
        return Outcome((float(values["emergency"]),), self._reward.since_last(values["reward"]), over)

    def urgent(self, samples: Mapping[str, Sample]) -> bool:
        """Say that it is urgent from the onset of Emergency until the joint has stopped."""
        values = samples[self._joint].values
        return bool(values["emergency"]) and not values["stopped"]

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return the motion command of an action."""
        return self._commands[action]

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say that stop is the correct answer."""
        return action == STOP
