"""The stopping task (thesis, section 3.4): stop the joint as soon as Normal turns to Emergency."""

from __future__ import annotations

from collections.abc import Mapping

from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus
from rtagent.saving import Saved
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import RewardMeter, require
from rtagent.tasks.sensors import Readings, numbers_sensed, picked

MOVE, STOP = 0, 1
EMERGENCY = "emergency"


class Stopping:
    """Stop a joint when its state changes from Normal to Emergency (thesis, Experiment 1).

    `signals` are names, `device.sensor`, or patterns such as `"arm.*"`, of further signals for demons to predict.
    They come after `emergency` in the state, called as for the task `Signals`; the state is then known once `bind`
    was called.
    """

    actions = ("move", "stop")

    def __init__(self, *, joint: str = "joint", signals: tuple[str, ...] = ()) -> None:
        self._joint, self._patterns = joint, signals
        self.state: Mapping[str, Spec] = {} if signals else {EMERGENCY: Spec.flag()}
        self._readings = Readings(())
        self._commands: tuple[Mapping[str, Command], ...] = tuple(
            {joint: {"motion": action}} for action in (MOVE, STOP)
        )
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Check that the joint is there, and find the signals; raise `SpecError`."""
        require(devices, self._joint, (EMERGENCY, "stopped", "at_end", "reward"), ("motion",))
        self._readings = Readings(picked(self._patterns, numbers_sensed(devices)), taken=(EMERGENCY,))
        self.state = {EMERGENCY: Spec.flag()} | self._readings.specs

    def begin(self) -> None:
        """Begin an episode."""
        self._reward.begin()

    def interpret(self, observation: Observation) -> Outcome:
        """Return whether it is an Emergency, and the signals; the episode ends with the joint at rest."""
        values = observation.samples[self._joint].values
        state = (float(values[EMERGENCY]), *self._readings(observation))
        over = bool(values["stopped"] or values["at_end"])
        return Outcome(state, self._reward.since_last(values["reward"]), over)

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

    def save(self) -> Saved:
        """Return what was earned in the episode so far."""
        return self._reward.save()

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned in the middle of an episode."""
        self._reward.restore(saved)
