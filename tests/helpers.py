"""What several test modules share: small devices, worlds, features and ways to run them."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent import Agent, Limits, Plan, Result, Schedule, clock, run, second
from rtagent.costs import Costs
from rtagent.device import Device
from rtagent.experience import Command, FeatureVector, Stimulus, Transition, Values
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import Greedy
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, Order
from rtagent.specs import DeviceSpec, Spec
from rtagent.supervision import Supervision
from rtagent.tasks import Stopping
from rtagent_drivers.stopping import stopping_joint

T = TypeVar("T")

STANDARD: Order = (ACT, OBSERVE, CHOOSE, LEARN)
REACTIVE: Order = (OBSERVE, CHOOSE, ACT, LEARN)


def rotations(order: Order) -> list[Order]:
    return [order[turn:] + order[:turn] for turn in range(len(order))]


def virtually(main: Coroutine[Any, Any, T], start: int | None = None) -> T:
    """Run `main` under the virtual clock."""
    return clock.run(main, "virtual", start)


def one_hot(*indices: int) -> FeatureVector:
    """Return binary features."""
    return FeatureVector(np.array(indices, dtype=np.intp))


def step(
    state: int,
    action: int | None,
    reward: float,
    following: int,
    next_action: int | None = None,
    *,
    terminated: bool = False,
    truncated: bool = False,
) -> Transition:
    """Return a transition between two states that have one feature each."""
    before, after = one_hot(state), one_hot(following)
    return Transition(before, action, 1.0, reward, after, next_action, 0, terminated, truncated)


def learn(agent: Agent) -> tuple[Transition, float]:
    """Learn the oldest transition of an agent's queue."""
    transition = agent.queue.popleft()
    return transition, agent.learner.update(transition)


class Scripted(Generator):
    """A generator for streams of samples: what each gets is planned, one jitter and four chances."""

    def __init__(self, jitters: Sequence[int], chances: Sequence[Sequence[float]] | NDArray[np.float64]) -> None:
        super().__init__(np.random.PCG64(0))
        self._jitters, self._chances = list(jitters), np.asarray(chances)
        self._jitters_given = self._chances_given = 0

    def integers(self, low: int, high: int, size: int, **settings: object) -> NDArray[Any]:  # type: ignore[override]
        self._jitters_given += size
        assert self._jitters_given <= len(self._jitters), "more samples were drawn than there is any need for"
        return np.array(self._jitters[self._jitters_given - size : self._jitters_given])

    def random(self, size: tuple[int, int]) -> NDArray[Any]:  # type: ignore[override]
        self._chances_given += size[0]
        assert self._chances_given <= len(self._chances), "more samples were drawn than there is any need for"
        return self._chances[self._chances_given - size[0] : self._chances_given]

    def spawn(self, count: int) -> list[Generator]:  # type: ignore[override]
        return [self] * count


class RampWorld:
    """A world whose one sensor shows for how many ns the episode has gone on, and that keeps its commands."""

    def __init__(self, changes: Sequence[int] = ()) -> None:
        self.spec = DeviceSpec(sensors={"age": Spec(low=0.0)}, actuators={"power": Spec(low=-1.0, high=1.0)})
        self._changes = changes
        self.commands: list[tuple[int, Command]] = []
        self.safe: list[int] = []
        self.began: list[int] = []

    def begin(self, now: int, rng: Generator) -> None:
        self.began.append(now)

    def values(self, time: int) -> Values:
        return {"age": float(time - self.began[-1])}

    def command(self, now: int, command: Command) -> Command:
        self.commands.append((now, command))
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        times = (self.began[-1] + change for change in self._changes)
        return [Stimulus(time) for time in times if after < time <= until]

    def next_change(self, now: int) -> int | None:
        times = (self.began[-1] + change for change in self._changes)
        return min((time for time in times if time > now), default=None)

    def make_safe(self, now: int) -> None:
        self.safe.append(now)


def visible(values: Values, names: Sequence[str]) -> Mapping[str, Any]:
    """Return only these sensors."""
    return {name: values[name] for name in names}


def read_in_any_order(
    read: Callable[[int], Values], times: Sequence[int], rng: Generator
) -> list[tuple[Values, Values]]:
    """Read a world at `times` in order, and again shuffled; return both readings of each time."""
    in_order = {time: read(time) for time in times}
    shuffled = [times[place] for place in rng.permutation(len(times))]
    again = {time: read(time) for time in shuffled}
    return [(in_order[time], again[time]) for time in times]


def run_joint(
    schedule: Schedule,
    *,
    joint: Device | None = None,
    episodes: int = 1,
    costs: Costs | None = None,
    instruments: Iterable[object] = (),
    supervision: Mapping[str, Supervision] | None = None,
    clock_name: clock.ClockName = "virtual",
) -> Result:
    """Run the stopping task with a greedy SARSA agent."""
    task = Stopping()

    def make_agent(rng: Generator) -> Agent:
        features = Tabular(state=task.state)
        return Agent(features, Sarsa(size=features.size, actions=2), Greedy(), rng)

    async def main() -> Result:
        plan = Plan(episodes=episodes, limits=Limits(episode_time=10 * second))
        devices = {"joint": joint or stopping_joint()}
        return await run(
            devices,
            task,
            make_agent,
            schedule,
            plan,
            costs=costs,
            supervision=supervision,
            instruments=instruments,
        )

    return clock.run(main(), clock_name)
