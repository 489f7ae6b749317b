"""A Gymnasium environment in the terms of rtagent: named signals, numbered actions, and the time of a step."""

from __future__ import annotations

import re
import warnings
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.random import Generator

from rtagent.errors import PluginError, SpecError, did_you_mean
from rtagent.experience import Values
from rtagent.specs import DeviceSpec, Spec
from rtagent.units import second

if TYPE_CHECKING:
    import gymnasium

SEEDS = 2**31
MOST_SIGNALS = 1000
"""An observation of more numbers is an image: it would take longer to name than to see."""

STEP_NAMES = ("tau", "dt")
"""What environments call the length of a step, in s."""

NONE: Mapping[str, tuple[float, float]] = MappingProxyType({})
COLOUR = re.compile(r"\x1b\[\d+m(WARN: )?")


class Frame(NamedTuple):
    """What is so from `time` (ns) on; `reward` is the sum since the episode began."""

    time: int
    observation: dict[str, float]
    reward: float = 0.0
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


@dataclass(frozen=True)
class View:
    """How an observation is named and bounded: a signal for each of its numbers, row by row.

    A number outside its range is given as the nearest within.
    """

    names: Sequence[str]
    ranges: Sequence[tuple[float, float]]
    dtype: Literal["float", "int"] = "float"

    @classmethod
    def of(cls, space: gymnasium.Space[Any], ranges: Mapping[str, tuple[float, float]]) -> View:
        """Return the view of an observation space, some ranges given; raise `SpecError` for what is no vector."""
        own, dtype = _ends(space)
        names = [f"observation_{place}" for place in range(len(own))]
        for name in ranges:
            if name not in names:
                raise SpecError(f"ranges: the environment has no {name!r}{did_you_mean(name, names)}")
        given = [ranges.get(name, ends) for name, ends in zip(names, own, strict=True)]
        return cls(names, given, dtype)

    def specs(self) -> dict[str, Spec]:
        """Return the specs of the signals."""
        named = zip(self.names, self.ranges, strict=True)
        return {name: Spec(dtype=self.dtype, low=low, high=high) for name, (low, high) in named}

    def values(self, observation: Any) -> dict[str, float]:
        """Return the signals of an observation; what is not a number stays so."""
        numbers = zip(self.names, np.ravel(observation).tolist(), self.ranges, strict=True)
        return {name: min(max(number, low), high) for name, number, (low, high) in numbers}


class Environment:
    """An environment whose observations are seen in `ranges`, and whose `actions`, if continuous, are these.

    Raises `SpecError` where its spaces do not fit. It is closed when nobody has it any more, or the program ends:
    it is the world, which goes on while a device is closed and opened anew.
    """

    def __init__(
        self,
        made: gymnasium.Env[Any, Any],
        ranges: Mapping[str, tuple[float, float]] = NONE,
        actions: Sequence[Sequence[float]] = (),
    ) -> None:
        weakref.finalize(self, made.close)
        self._made, self._view = made, View.of(made.observation_space, ranges)
        self._actions = choices(made.action_space, actions)

    @property
    def actions(self) -> int:
        """How many actions there are."""
        return len(self._actions)

    def spec(self, synchronous: bool) -> DeviceSpec:
        """Return what can be sensed and commanded."""
        outcome = {"reward": Spec(), "terminated": Spec.flag(), "truncated": Spec.flag()}
        actuators = {"action": Spec.discrete(len(self._actions))}
        return DeviceSpec(self._view.specs() | outcome, actuators, synchronous=synchronous)

    def reset(self, rng: Generator) -> dict[str, float]:
        """Begin an episode with a seed drawn from `rng`; return its first observation."""
        observation, _ = self._made.reset(seed=int(rng.integers(SEEDS)))
        return self._view.values(observation)

    def step(self, last: Frame, action: int, duration: int) -> Frame:
        """Make a step that takes `duration` (ns)."""
        observation, reward, terminated, truncated, _ = self._made.step(self._actions[action])
        total, time = last.reward + float(reward), last.time + duration
        return Frame(time, self._view.values(observation), total, bool(terminated), bool(truncated))


class Made(NamedTuple):
    """What `gymnasium.make` returned, and its warnings."""

    environment: gymnasium.Env[Any, Any]
    warnings: Sequence[str]


def make(name: str, arguments: Mapping[str, Any]) -> Made:
    """Make an environment by its id; raise `SpecError` where that fails, `PluginError` without the package."""
    try:
        import gymnasium
    except ImportError as error:
        raise PluginError(
            "the driver 'gymnasium' needs the package of that name: pip install 'rtagent[gymnasium]'."
        ) from error
    if arguments.get("render_mode") == "human":
        raise SpecError("arguments.render_mode 'human' waits for a window at each step: leave it out.")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            made: gymnasium.Env[Any, Any] = gymnasium.make(name, **{"disable_env_checker": True, **arguments})
        except gymnasium.error.NameNotFound as error:
            raise SpecError(f"there is no environment {name!r}{_nearest(name, gymnasium.registry)}") from error
        except Exception as error:  # an environment may raise anything
            raise SpecError(f"the environment {name!r} cannot be made: {_plain(error)}") from error
    return Made(made, [_plain(each.message) for each in caught])


def _nearest(name: str, registry: Mapping[str, Any]) -> str:
    """Return the end of a sentence: the nearest id, or how to see them all (there are dozens)."""
    hint = did_you_mean(name, list(registry))
    return (
        hint if "did you mean" in hint else ': python -c "import gymnasium; gymnasium.pprint_registry()" lists all.'
    )


def _plain(said: object) -> str:
    """Return what gymnasium says as a sentence without colours."""
    return COLOUR.sub("", str(said)).rstrip(".") + "."


def _ends(space: gymnasium.Space[Any]) -> tuple[list[tuple[float, float]], Literal["float", "int"]]:
    """Return the range of each number of an observation."""
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete):
        return [(int(space.start), int(space.start + space.n - 1))], "int"
    if not isinstance(space, Box) or space.dtype.kind not in "fiu":
        raise SpecError(
            f"its observations are {space}: a Box of numbers or a Discrete is needed; "
            "register the environment with gymnasium.wrappers.FlattenObservation, and name that."
        )
    if not 0 < np.prod(space.shape, dtype=int) <= MOST_SIGNALS:
        raise SpecError(
            f"its observations are {np.prod(space.shape, dtype=int)} numbers, of 1 to {MOST_SIGNALS} that can "
            "be signals: register the environment with a wrapper that makes features of them, and name that."
        )
    low, high = (np.ravel(end).astype(float).tolist() for end in (space.low, space.high))
    return list(zip(low, high, strict=True)), "float"


def choices(space: gymnasium.Space[Any], given: Sequence[Sequence[float]]) -> list[Any]:
    """Return what the actions 0, 1, … are to the environment; raise `SpecError` where they cannot be told."""
    from gymnasium.spaces import Box, Discrete

    if isinstance(space, Discrete):
        if given:
            raise SpecError(f"its actions are {space}, numbered by itself: leave out actions.")
        return [int(space.start) + action for action in range(int(space.n))]
    if not isinstance(space, Box):
        raise SpecError(
            f"its actions are {space}: a Discrete or a Box is needed; "
            "register the environment with a wrapper that makes one of them, and name that."
        )
    if not given:
        raise SpecError(
            f"its actions are {space}: give actions, a list of those to choose from, such as [[-1], [1]]."
        )
    return [_checked(space, action) for action in given]


def _checked(space: gymnasium.spaces.Box, action: Sequence[float]) -> Any:
    made = np.array(action, dtype=space.dtype)
    if made.size != np.prod(space.shape, dtype=int) or not space.contains(made.reshape(space.shape)):
        raise SpecError(f"actions: {list(action)} is none of its actions, which are {space}.")
    return made.reshape(space.shape)


class Step(NamedTuple):
    """How long a step is, in ns, and what in the environment says so."""

    length: int
    source: str


def own_step(environment: gymnasium.Env[Any, Any]) -> Step:
    """Return the environment's own time step; raise `SpecError` where it has none."""
    for name in STEP_NAMES:
        length = _above_0(getattr(environment.unwrapped, name, None))
        if length and round(length * second):
            return Step(round(length * second), name)
    rate = _above_0(environment.metadata.get("render_fps"))
    if rate:
        return Step(round(second / rate), "render_fps")
    raise SpecError("this environment does not say how long a step of it is: give step a time, such as 20ms.")


def _above_0(value: Any) -> float | None:
    """Return a finite number above 0, and None for anything else."""
    return float(value) if isinstance(value, int | float | np.number) and 0 < value < inf else None
