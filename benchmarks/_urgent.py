"""A world that is urgent half of the time, and what an agent that learns while it is calm came to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sin

import numpy as np
from numpy.random import Generator

from rtagent import (
    Agent,
    DeviceSpec,
    Limits,
    Observation,
    Outcome,
    Plan,
    Result,
    Sample,
    Schedule,
    Spec,
    Stimulus,
    Transition,
    run,
)
from rtagent.experience import Command, Values
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import EpsilonGreedy
from rtagent.units import ms, second
from rtagent_drivers.fake import FakeDevice

TURN = 100 * ms
PERIOD, COST = 5 * ms, 2 * ms
"""A transition comes every 5 ms and takes 2 ms to learn: 40 % of the time, of which half is calm."""
LENGTH = 60 * second


class AlarmWorld:
    """An alarm that is on for 100 ms and off for as long."""

    spec = DeviceSpec(
        sensors={"alarm": Spec.flag(), "level": Spec(low=-1.0, high=1.0)}, actuators={"answer": Spec.discrete(2)}
    )

    def begin(self, now: int, rng: Generator) -> None:
        self._start = now

    def values(self, time: int) -> Values:
        elapsed = time - self._start
        return {"alarm": elapsed // TURN % 2 == 1, "level": sin(elapsed / second)}

    def command(self, now: int, command: Command) -> Command:
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        return ()

    def next_change(self, now: int) -> int | None:
        return now + TURN - (now - self._start) % TURN

    def make_safe(self, now: int) -> None: ...


class AlarmTask:
    """The alarm is the state, and urgent; the level is what an answer earns."""

    state: Mapping[str, Spec] = {"alarm": Spec.flag()}
    actions: Sequence[str] = ("wait", "answer")

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None: ...

    def begin(self) -> None: ...

    def interpret(self, observation: Observation) -> Outcome:
        values = observation.samples["alarm"].values
        return Outcome((float(values["alarm"]),), float(values["level"]))

    def urgent(self, samples: Mapping[str, Sample]) -> bool:
        return bool(samples["alarm"].values["alarm"])

    def commands(self, action: int) -> Mapping[str, Command]:
        return {"alarm": {"answer": action}}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return False


class Kept:
    """Keeps the transitions that were learned."""

    def __init__(self) -> None:
        self.transitions: list[Transition] = []

    def learned(self, transition: Transition, delta: float, end: int) -> None:
        self.transitions.append(transition)


def learner(features: Tabular) -> Sarsa:
    """Return the learner of the agent."""
    return Sarsa(size=features.size, actions=len(AlarmTask.actions))


async def deferred_run() -> tuple[Result, list[Transition]]:
    """Run an agent that learns only while it is calm; return the result, and the transitions in their order."""
    task, kept = AlarmTask(), Kept()
    features = Tabular(state=task.state)
    agent = Agent(features, learner(features), EpsilonGreedy(epsilon=0.3))
    plan = Plan(limits=Limits(episode_time=LENGTH))
    schedule = Schedule.preset("deferred", learn_delay=COST, period=PERIOD)
    result = await run({"alarm": FakeDevice(AlarmWorld())}, task, agent, schedule, plan, instruments=[kept])
    return result, sorted(kept.transitions, key=lambda transition: transition.complete_at)


def difference_to_inline(result: Result, transitions: Sequence[Transition]) -> float:
    """Return by how much weights differ from those of learning the same transitions one after the other."""
    inline = learner(Tabular(state=AlarmTask.state))
    for transition in transitions:
        inline.update(transition)
    return float(np.abs(inline.weights - result.agents[0].learner.weights).max())
