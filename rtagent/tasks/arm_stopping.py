"""The stopping task (thesis, section 3.4) on a joint of a real arm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from rtagent.errors import SpecError
from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import require
from rtagent.tasks.sensors import Readings, numbers_sensed, picked
from rtagent.units import Angle, AngularVelocity, Duration, degree, second

MOVE, STOP = 0, 1
EMERGENCY = "emergency"
EPISODE, COSTS = ("_emergency", "_answered", "_let_go"), ("_since", "_needless", "_told")
"""What is saved."""


class Seen(NamedTuple):
    """The joint at a time (ns): how far (rad) it is `left` to go to the obstacle, and its speed (rad/s)."""

    time: int
    left: float
    speed: float


class ArmStopping:
    """Turn a joint at a constant speed, and stop it as soon as a flag says Emergency (thesis, Experiment 1).

    `joint` is `device.joint`, `emergency` a flag, `device.sensor`. The joint turns at `velocity` (its sign is
    the direction). The episode ends with the joint at rest after a stop in Emergency, or, as a miss, beyond the
    position `end`. Slower than `at_rest` is at rest. Emergency costs 1 for each `reward_unit` from its onset
    until the joint is at rest, by the times of the samples; a stop that was chosen in Normal costs 1, and the
    joint does stop. With `latched` it is Emergency from when the flag turns true until the end of the episode, as
    it must be with a button that is let go; one that is still held from before does not count. A stop has failed
    where the joint comes to `obstacle`.
    `signals` are further ones for demons, as for the task `stopping`.
    """

    actions = ("move", "stop")

    def __init__(
        self,
        *,
        joint: str,
        emergency: str,
        end: Angle,
        velocity: AngularVelocity = 30 * degree,
        at_rest: AngularVelocity = 3 * degree,
        reward_unit: Duration = second,
        latched: bool = False,
        obstacle: Angle | None = None,
        signals: tuple[str, ...] = (),
    ) -> None:
        if not (velocity and reward_unit > 0):
            raise SpecError(
                "velocity is 0, or reward_unit not above 0: give the joint a speed, and the cost a unit."
            )
        if not 0 < at_rest < abs(velocity):
            raise SpecError("at_rest is above 0 and below the velocity at which the joint turns.")
        self._joint, self._flag = _Place.of(joint, "joint"), _Place.of(emergency, "emergency")
        self._velocity, self._end, self._at_rest = velocity, end, at_rest
        self._latched, self.obstacle = latched, obstacle
        self._costs = _Costs(reward_unit)
        self._patterns = signals
        self.state: Mapping[str, Spec] = {EMERGENCY: Spec.flag()}
        self._readings = Readings(())
        speed = f"{self._joint.name}_velocity"
        self._commands = tuple({self._joint.device: {speed: chosen}} for chosen in (velocity, 0.0))
        self.begin()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        """Check that joint and flag are there, and find the signals; raise `SpecError`."""
        name, device = self._joint.name, self._joint.device
        self._position_at, self._velocity_at = f"{name}_position", f"{name}_velocity"
        require(devices, device, (self._position_at, self._velocity_at), (self._velocity_at,))
        require(devices, self._flag.device, (self._flag.name,), ())
        if devices[self._flag.device].sensors[self._flag.name].dtype != "bool":
            raise SpecError(f"emergency is {self._flag}, which is not true or false: name a flag.")
        devices[device].actuators[self._velocity_at].validate(self._velocity, "velocity")
        devices[device].sensors[self._position_at].validate(self._end, "end")
        if self.obstacle is not None and self._way(self.obstacle) >= self._way(self._end):
            raise SpecError(
                f"obstacle is {self.obstacle:g} rad, not before the end at {self._end:g} rad: put it there."
            )
        self._readings = Readings(picked(self._patterns, numbers_sensed(devices)), taken=(EMERGENCY,))
        self.state = {EMERGENCY: Spec.flag()} | self._readings.specs

    def begin(self) -> None:
        """Begin an episode."""
        self._emergency = self._answered = self._let_go = False
        self._costs.begin()

    def interpret(self, observation: Observation) -> Outcome:
        """Return whether it is an Emergency, and the signals; a joint at rest or at its end ends the episode."""
        joint, flag = (observation.samples[place.device] for place in (self._joint, self._flag))
        self._emergency = self._is_emergency(flag)
        self._let_go = self._let_go or not flag.values[self._flag.name]
        if self._emergency:
            self._costs.emergency_since(flag.world_time)
        stopped = self._answered and self._rests(joint)
        reward = self._costs.since_last(joint.world_time)
        state = (float(self._emergency), *self._readings(observation))
        return Outcome(state, reward, stopped or self._at_end(joint))

    def urgent(self, samples: Mapping[str, Sample]) -> bool:
        """Say that it is urgent from the onset of Emergency until the joint is at rest."""
        emergency = self._is_emergency(samples[self._flag.device])
        return emergency and not self._rests(samples[self._joint.device])

    def commands(self, action: int) -> Mapping[str, Command]:
        """Return the velocity command of an action; a stop in Normal costs."""
        self._answered = action == STOP and self._emergency
        if action == STOP and not self._emergency:
            self._costs.needless_stop()
        return self._commands[action]

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        """Say that stop is the correct answer."""
        return action == STOP

    # What is judged

    @property
    def button(self) -> str:
        """The device whose flag is the Emergency."""
        return self._flag.device

    def seen(self, samples: Mapping[str, Sample]) -> Seen:
        """Return how the joint moves, and how far it is from the obstacle (its end, where there is none)."""
        joint = samples[self._joint.device]
        place = self._end if self.obstacle is None else self.obstacle
        left = self._way(place) - self._way(float(joint.values[self._position_at]))
        return Seen(joint.world_time, left, abs(float(joint.values[self._velocity_at])))

    @property
    def speed(self) -> float:
        """How fast (rad/s) the joint is to turn."""
        return abs(self._velocity)

    def save(self) -> Saved:
        """Return what has happened in the episode, as far as its reward and its end depend on it."""
        return save_fields(self, EPISODE) | {"costs": self._costs.save()}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned in the middle of an episode."""
        restore_fields(self, EPISODE, saved)
        self._costs.restore(saved["costs"])

    def _is_emergency(self, flag: Sample) -> bool:
        held = bool(flag.values[self._flag.name])
        return self._emergency or (held and self._let_go) if self._latched else held

    def _rests(self, joint: Sample) -> bool:
        return abs(float(joint.values[self._velocity_at])) < self._at_rest

    def _at_end(self, joint: Sample) -> bool:
        return self._way(float(joint.values[self._position_at])) >= self._way(self._end)

    def _way(self, position: float) -> float:
        """Return how far (rad) a position is in the direction of the motion."""
        return position if self._velocity > 0 else -position


@dataclass(frozen=True)
class _Place:
    """A name within a device."""

    device: str
    name: str

    @classmethod
    def of(cls, text: str, setting: str) -> _Place:
        device, _, name = text.partition(".")
        if not name:
            raise SpecError(f'{setting} is {text!r}: write the device and the name within it, as "arm.elbow".')
        return cls(device, name)

    def __str__(self) -> str:
        return f"{self.device}.{self.name}"


class _Costs:
    """What an episode costs, by the times (ns) of samples; each part of it is told once."""

    def __init__(self, unit: int) -> None:
        self._unit = unit

    def begin(self) -> None:
        """Begin an episode."""
        self._since: int | None = None
        self._needless, self._told = 0, 0.0

    def emergency_since(self, time: int) -> None:
        """Note that Emergency began at `time`; only the first time counts."""
        self._since = time if self._since is None else self._since

    def needless_stop(self) -> None:
        """Note a stop that nothing called for."""
        self._needless += 1

    def since_last(self, time: int) -> float:
        """Return the reward of what happened until `time`, in so far as it was not told before."""
        emergency = 0.0 if self._since is None else max(0, time - self._since) / self._unit
        total = -(self._needless + emergency)
        reward, self._told = total - self._told, total
        return reward

    def save(self) -> Saved:
        """Return what was noted and told."""
        return save_fields(self, COSTS)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_fields(self, COSTS, saved)
