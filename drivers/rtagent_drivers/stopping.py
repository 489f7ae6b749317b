"""The stopping task's joint (thesis, section 3.4.1): it turns at constant velocity until it is stopped.

Normal turns to Emergency at a time drawn uniformly; the end of the joint's range ends the episode as a miss.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import ceil, pi

from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Angle, AngularVelocity, Duration, ms, second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling

MOVE, STOP = 0, 1


class StoppingWorld:
    """A joint that turns from 0 to `travel` (rad) at `velocity` (rad/s).

    `reward` is the sum since the episode began: -1 for each stop in Normal; in Emergency minus the time from
    its onset to the arrival of the stop, in units of `reward_unit` (ns; the thesis: microseconds).
    """

    def __init__(self, travel: float, velocity: float, onset: tuple[int, int], reward_unit: int) -> None:
        self._travel, self._velocity, self._onsets, self._unit = travel, velocity, onset, reward_unit
        self.spec = DeviceSpec(
            sensors={
                "position": Spec(unit="rad", low=0.0, high=travel),
                "velocity": Spec(unit="rad/s", low=0.0, high=velocity),
                "emergency": Spec.flag(),
                "stopped": Spec.flag(),
                "at_end": Spec.flag(),
                "reward": Spec(high=0.0),
            },
            actuators={"motion": Spec.discrete(2)},
        )

    def begin(self, now: int, rng: Generator) -> None:
        """Start turning, and draw the onset of Emergency."""
        self._start = now
        self._onset = now + int(rng.integers(*self._onsets, endpoint=True))
        self._end = now + ceil(self._travel / self._velocity * second)
        self._stopped: int | None = None
        self._needless_stops: list[int] = []

    def values(self, time: int) -> Values:
        """Return the sensors at `time` (ns)."""
        stopped = self._stopped is not None and time >= self._stopped
        at_end = not stopped and time >= self._end
        moved = self._moved_until(time)
        return {
            "position": min(self._velocity * (moved - self._start) / second, self._travel),
            "velocity": 0.0 if stopped or at_end else self._velocity,
            "emergency": time >= self._onset,
            "stopped": stopped,
            "at_end": at_end,
            "reward": -self._cost_until(time),
        }

    def command(self, now: int, command: Command) -> Command:
        """Take a motion command: a stop in Emergency stops the joint, one in Normal only costs."""
        if command.get("motion") == STOP and self._stopped is None and now < self._end:
            if now >= self._onset:
                self._stopped = now
            else:
                self._needless_stops.append(now)
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return the onset of Emergency, if it lies between and the joint still turned."""
        still_turned = self._onset < (self._end if self._stopped is None else self._stopped + 1)
        if after < self._onset <= until and still_turned:
            return (Stimulus(self._onset, "emergency"),)
        return ()

    def next_change(self, now: int) -> int | None:
        """Return the onset, or the end of the range, whichever is next."""
        times = (self._onset, self._end) if self._stopped is None else (self._onset,)
        return min((time for time in times if time > now), default=None)

    def make_safe(self, now: int) -> None:
        """Stop the joint, whatever the state."""
        if self._stopped is None and now < self._end:
            self._stopped = now

    def save(self) -> Saved:
        """Return what commands have done to it."""
        return save_fields(self, ("_stopped", "_needless_stops"))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned, when it has begun."""
        restore_fields(self, ("_stopped", "_needless_stops"), saved)

    def _moved_until(self, time: int) -> int:
        return min(time, self._end, time if self._stopped is None else self._stopped)

    def _cost_until(self, time: int) -> float:
        needless = bisect_right(self._needless_stops, time)
        return needless + max(0, self._moved_until(time) - self._onset) / self._unit


def stopping_joint(
    *,
    travel: Angle = 300 / 180 * pi,
    velocity: AngularVelocity = 100 / 180 * pi,
    onset: tuple[Duration, Duration] = (500 * ms, 1500 * ms),
    reward_unit: Duration = second,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> FakeDevice:
    """A fake joint that turns until it is stopped, with an Emergency (thesis, Experiment 1)."""
    if not (travel > 0 and velocity > 0 and reward_unit > 0):
        raise SpecError("travel, velocity and reward_unit are above 0.")
    if not 0 <= onset[0] <= onset[1]:
        raise SpecError("onset is [earliest, latest], both 0 or more and in this order.")
    if onset[1] >= travel / velocity * second:
        raise SpecError("the latest onset is after the end of the travel: lower it, or the velocity.")
    return FakeDevice(StoppingWorld(travel, velocity, onset, reward_unit), sampling, faults)
