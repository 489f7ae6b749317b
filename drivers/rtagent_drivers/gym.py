"""Any Gymnasium environment as a world that does not wait: it goes on at its own step under the last action."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.random import Generator

from rtagent.errors import PluginError, SpecError, did_you_mean
from rtagent.experience import Command, Stimulus, Values
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import Duration, second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling

if TYPE_CHECKING:
    import gymnasium

SEEDS = 2**31
STEP_NAMES = ("tau", "dt")
"""What environments call the length of a step, in s."""

KEPT = 1000
"""At least so many steps are remembered, for samples that come late."""


@dataclass(frozen=True)
class View:
    """How an environment's observation is named and bounded: a signal for each of its numbers.

    A value outside its range is given as the nearest within.
    """

    names: Sequence[str]
    low: Sequence[float]
    high: Sequence[float]

    @classmethod
    def of(cls, space: gymnasium.Space[Any], ranges: Mapping[str, tuple[float, float]]) -> View:
        """Return the view of an observation space; raise `SpecError` where it is no vector of numbers."""
        low, high = _bounds(space)
        names = [f"observation_{place}" for place in range(len(low))]
        for name in ranges:
            if name not in names:
                raise SpecError(f"ranges: there is no {name!r}{did_you_mean(name, names)}")
        given = [ranges.get(name, ends) for name, ends in zip(names, zip(low, high, strict=True), strict=True)]
        return cls(names, [ends[0] for ends in given], [ends[1] for ends in given])

    def specs(self) -> dict[str, Spec]:
        """Return the specs of the signals."""
        ends = zip(self.names, self.low, self.high, strict=True)
        return {name: Spec(low=low, high=high) for name, low, high in ends}

    def values(self, observation: Any) -> dict[str, float]:
        """Return the signals of an observation."""
        numbers = np.clip(np.ravel(observation), self.low, self.high)
        return dict(zip(self.names, numbers.tolist(), strict=True))


class Frame(NamedTuple):
    """What is so from `time` (ns) on; `reward` is the sum since the episode began."""

    time: int
    observation: dict[str, float]
    reward: float
    terminated: bool = False
    truncated: bool = False

    @property
    def over(self) -> bool:
        """Whether the environment has ended."""
        return self.terminated or self.truncated

    def values(self) -> Values:
        """Return it as the sensors give it."""
        return self.observation | {
            "reward": self.reward,
            "terminated": self.terminated,
            "truncated": self.truncated,
        }


class GymnasiumWorld:
    """An environment as a function of time; what it did is kept, for samples that come late.

    Before the first command of an episode it is under action `idle`. `actions` are what is handed to the
    environment for the actions 0, 1, ….
    """

    def __init__(
        self, environment: gymnasium.Env[Any, Any], view: View, actions: Sequence[Any], step: int, idle: int
    ) -> None:
        self._environment, self._view, self._actions = environment, view, actions
        self._step, self._idle = step, idle
        self.spec = _spec(view, len(actions), synchronous=False)

    def begin(self, now: int, rng: Generator) -> None:
        """Reset the environment with a seed drawn from `rng`."""
        observation, _ = self._environment.reset(seed=int(rng.integers(SEEDS)))
        self._frames = [Frame(now, self._view.values(observation), 0.0)]
        self._action = self._idle

    def values(self, time: int) -> Values:
        """Return the newest frame at `time` (ns)."""
        self._advance(time)
        return self._frames[bisect_right(self._frames, time, key=lambda frame: frame.time) - 1].values()

    def command(self, now: int, command: Command) -> Command:
        """Take the action that is in force from now on."""
        self._advance(now)
        self._action = int(command["action"])
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: no environment says what calls for a reaction."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return the time of the next step, if there is one."""
        self._advance(now)
        newest = self._frames[-1]
        return None if newest.over else newest.time + self._step

    def make_safe(self, now: int) -> None:
        """Do nothing: nothing of it moves outside this process."""

    def _advance(self, time: int) -> None:
        newest = self._frames[-1]
        while not newest.over and newest.time + self._step <= time:
            newest = stepped(self._environment, self._view, newest, self._actions[self._action], self._step)
            self._frames.append(newest)
        if len(self._frames) > 2 * KEPT:
            del self._frames[:KEPT]


class SynchronousGymnasiumWorld:
    """An environment that waits: each command is a step of it, and nothing else is."""

    def __init__(self, environment: gymnasium.Env[Any, Any], view: View, actions: Sequence[Any]) -> None:
        self._environment, self._view, self._actions = environment, view, actions
        self.spec = _spec(view, len(actions), synchronous=True)

    def begin(self, now: int, rng: Generator) -> None:
        """Reset the environment with a seed drawn from `rng`."""
        observation, _ = self._environment.reset(seed=int(rng.integers(SEEDS)))
        self._newest = Frame(now, self._view.values(observation), 0.0)

    def values(self, time: int) -> Values:
        """Return what the last step gave."""
        return self._newest.values()

    def command(self, now: int, command: Command) -> Command:
        """Make a step."""
        if not self._newest.over:
            action = self._actions[int(command["action"])]
            self._newest = stepped(self._environment, self._view, self._newest, action, 0)
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: nothing happens by itself."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return None: nothing happens by itself."""
        return None

    def make_safe(self, now: int) -> None:
        """Do nothing: it does not move by itself."""


def stepped(environment: gymnasium.Env[Any, Any], view: View, last: Frame, action: Any, duration: int) -> Frame:
    """Make one step of an environment, of so long a `duration` (ns)."""
    observation, reward, terminated, truncated, _ = environment.step(action)
    total = last.reward + float(reward)
    return Frame(last.time + duration, view.values(observation), total, bool(terminated), bool(truncated))


def gymnasium_world(
    *,
    environment: str,
    arguments: dict[str, Any] | None = None,
    step: Duration = 0,
    synchronous: bool = False,
    ranges: dict[str, tuple[float, float]] | None = None,
    actions: tuple[tuple[float, ...], ...] = (),
    idle: int = 0,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> FakeDevice:
    """A Gymnasium environment that goes on by itself at its own time step, or step by step if synchronous."""
    made = _made(environment, arguments or {})
    view = View.of(made.observation_space, ranges or {})
    choices = _choices(made.action_space, actions)
    if not 0 <= idle < len(choices):
        raise SpecError(f"idle is {idle}: give one of the {len(choices)} actions, counted from 0.")
    if synchronous:
        return FakeDevice(SynchronousGymnasiumWorld(made, view, choices), sampling, faults)
    step = step or _own_step(made)
    world = GymnasiumWorld(made, view, choices, step, idle)
    return FakeDevice(world, sampling or Sampling(rate=second / step), faults)


def _spec(view: View, actions: int, synchronous: bool) -> DeviceSpec:
    outcome = {"reward": Spec(), "terminated": Spec.flag(), "truncated": Spec.flag()}
    return DeviceSpec(view.specs() | outcome, {"action": Spec.discrete(actions)}, synchronous=synchronous)


def _made(environment: str, arguments: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    try:
        import gymnasium
    except ImportError as error:
        raise PluginError(
            "the driver 'gymnasium' needs the package of that name: pip install 'rtagent[gymnasium]'."
        ) from error
    try:
        made: gymnasium.Env[Any, Any] = gymnasium.make(environment, **arguments)
    except (gymnasium.error.Error, TypeError, ImportError) as error:
        raise SpecError(f"environment {environment!r} cannot be made: {error}") from error
    return made


def _bounds(space: gymnasium.Space[Any]) -> tuple[list[float], list[float]]:
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete):
        return [float(space.start)], [float(space.start + space.n - 1)]
    if isinstance(space, Box) and space.dtype.kind in "fiu":
        return np.ravel(space.low).astype(float).tolist(), np.ravel(space.high).astype(float).tolist()
    raise SpecError(
        f"its observations are {space}: a Box of numbers or a Discrete is needed; wrap the environment."
    )


def _choices(space: gymnasium.Space[Any], given: Sequence[Sequence[float]]) -> list[Any]:
    """Return what the actions 0, 1, … are to the environment."""
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete) and not given:
        return [int(space.start) + action for action in range(int(space.n))]
    if isinstance(space, Box):
        made = [np.array(action, dtype=space.dtype) for action in given]
        if made and all(action.shape == space.shape and space.contains(action) for action in made):
            return list(made)
        raise SpecError(
            f"its actions are {space}: give actions, a list of those to choose from, such as [[-1], [1]]."
        )
    if given:
        raise SpecError(f"its actions are {space}, which has its own: leave out actions.")
    raise SpecError(f"its actions are {space}: a Discrete or a Box is needed; wrap the environment.")


def _own_step(environment: gymnasium.Env[Any, Any]) -> int:
    """Return the environment's own time step in ns; raise `SpecError` where it has none."""
    for name in STEP_NAMES:
        length = getattr(environment.unwrapped, name, None)
        if isinstance(length, int | float) and length > 0:
            return round(length * second)
    rate = float(environment.metadata.get("render_fps") or 0.0)
    if not rate:
        raise SpecError("this environment does not say how long a step of it is: give step a time, such as 20ms.")
    return round(second / rate)
