"""Which condition an episode of a trial has: its order of components, and the frozen agent that chooses.

A trial is one run, so that person, devices and telemetry go on through all conditions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator

from rtagent.agent import Agent
from rtagent.errors import ScheduleError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning import ControlLearner
from rtagent.scenario import Assembly
from rtagent.schedule import ACT, PRESETS, STANDARD, Component, Order, Schedule, Situation
from rtagent.streams import stream

CONTROL = "control"
SARSA, REACTIVE_SARSA = "standard", "reactive"
"""The thesis's conditions are called by their presets."""

NAMES = {CONTROL: "control", SARSA: "SARSA", REACTIVE_SARSA: "reactive SARSA"}
"""What readers know them by."""

WIRED = np.array([[1.0, 0.0], [0.0, 1.0]])
"""What moving and stopping are worth in Normal and in Emergency to who is wired to stop."""


def shuffled(mixed: Sequence[str], control: int, each: int, seed: int) -> list[str]:
    """Return the conditions of a trial: `control` episodes to practise, then `each` of those `mixed`, shuffled."""
    rest = [condition for condition in mixed for _ in range(each)]
    return [CONTROL] * control + [rest[place] for place in stream(seed, "conditions").permutation(len(rest))]


class Blinding:
    """An instrument that knows which condition the episode has that has just begun."""

    def __init__(self, conditions: Sequence[str]) -> None:
        self.conditions, self.now = conditions, conditions[0]

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Go over to the condition of an episode."""
        self.now = self.conditions[episode]


class Frozen:
    """The learned agents of all conditions: it values actions as the one does whose turn it is, and learns nothing.

    What is still to be learned takes the time that learning takes.
    """

    needs_next_action = True

    def __init__(self, learned: Mapping[str, ControlLearner], blinding: Blinding) -> None:
        self._learned, self._blinding = learned, blinding

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return the action values of the agent whose turn it is, shape (actions,)."""
        return self._learned[self._blinding.now].action_values(features)

    def update(self, transition: Transition) -> float:
        """Learn nothing."""
        return 0.0


class Wired:
    """Stops in Emergency and moves in Normal, by design; for features that are one for each of both."""

    needs_next_action = True

    def action_values(self, features: FeatureVector) -> FloatArray:
        """Return 1 for the right action and 0 for the other, shape (2,)."""
        values: FloatArray = WIRED[features.indices[0]]
        return values

    def update(self, transition: Transition) -> float:
        """Learn nothing."""
        return 0.0


class InTurn:
    """A chooser: in each episode the order of its condition, from what must run once before it on.

    What runs before the first cycle ends with a choice. `standard` begins by carrying it out, and Algorithm 3
    carries it out before its first cycle, too.
    """

    def __init__(self, order: Order) -> None:
        self._order, self._first = order, order is not STANDARD

    def cycle(self, situation: Situation) -> Iterable[Component]:
        """Return the order; in the first cycle of one that observes first only what was chosen already is done."""
        if self._first:
            self._first = False
            return (ACT,)
        return self._order


def schedule_of(conditions: Iterable[str], given: Schedule) -> Schedule:
    """Return the schedule of a trial with these conditions, paced and charged as `given`, each in its own order.

    Raises `ScheduleError` where conditions that learn by different rules are mixed.
    """
    presets = {_preset(condition) for condition in conditions}
    rules = {PRESETS[preset].learn for preset in presets}
    if len(rules) > 1:
        raise ScheduleError(f"{', '.join(sorted(presets))} learn by different rules: give each a trial of its own.")
    learn = given.learn if given.name in presets else rules.pop()
    return replace(given, order=STANDARD, ordering=None, name=" and ".join(sorted(presets)), learn=learn)


def order_of(condition: str) -> Order:
    """Return the order of a condition's components; control acts at once, as reactive does."""
    return PRESETS[_preset(condition)].order


def _preset(condition: str) -> str:
    return REACTIVE_SARSA if condition == CONTROL else condition


def in_conditions(
    assembly: Assembly, conditions: Sequence[str], learned: Mapping[str, ControlLearner]
) -> tuple[Assembly, Blinding]:
    """Return a run as one trial with an episode for each of `conditions`, and the instrument that leads through it.

    `learned` are learners by conditions, which are not changed; that of control, if it is not among them, is wired.
    """
    blinding = Blinding(conditions)
    frozen = Frozen({CONTROL: Wired(), **learned}, blinding)
    schedule = replace(schedule_of(conditions, assembly.schedule), chooser=lambda: InTurn(order_of(blinding.now)))

    def make_agent(rng: Generator) -> Agent:
        agent = assembly.make_agent(rng)
        return Agent(agent.features, frozen, agent.policy, rng)

    plan = replace(assembly.plan, trials=1, episodes=len(conditions))
    return replace(assembly, schedule=schedule, plan=plan, make_agent=make_agent), blinding
