"""A world that calls for a reaction every few ms, and an agent whose choice takes as long as is asked."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

from helpers import RampWorld, one_hot
from numpy.random import Generator

from rtagent import Agent, Limits, Plan, Result, Schedule, ms, run
from rtagent.clock import occupy
from rtagent.experience import Command, FeatureVector, Observation, Outcome, State, Stimulus
from rtagent.learning import Sarsa
from rtagent.specs import DeviceSpec
from rtagent_drivers.fake import FakeDevice, Sampling

EVERY, LASTS = 4 * ms, 120 * ms


class Answering:
    """A task in which every act answers."""

    state: Mapping[str, Any] = {}
    actions = ("answer",)

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None: ...

    def begin(self) -> None: ...

    def interpret(self, observation: Observation) -> Outcome:
        return Outcome(())

    def commands(self, action: int) -> Mapping[str, Command]:
        return {"ramp": {"power": 0.0}}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return True


class OneFeature:
    size = active = 1

    def encode(self, state: State) -> FeatureVector:
        return one_hot(0)


class Pondering:
    """A policy that keeps a core busy for so long (ns)."""

    def __init__(self, takes: int) -> None:
        self.takes = takes

    def choose(self, values: object, rng: Generator) -> tuple[int, float]:
        occupy(self.takes)
        return 0, 1.0

    def probabilities(self, values: object) -> Sequence[float]:
        return [1.0]


def reacting(choose: int, lasts: int = LASTS) -> Callable[[], Coroutine[Any, Any, Result]]:
    """Return what makes a run in which choosing takes so long (ns)."""

    def make() -> Coroutine[Any, Any, Result]:
        ramp = FakeDevice(RampWorld(range(EVERY // 2, lasts, EVERY)), Sampling(rate=1e9 / EVERY))
        agent = Agent(OneFeature(), Sarsa(size=1, actions=1), Pondering(choose))  # type: ignore[arg-type]
        plan = Plan(limits=Limits(episode_time=lasts))
        return run({"ramp": ramp}, Answering(), agent, Schedule.preset("reactive"), plan)

    return make
