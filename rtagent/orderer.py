"""An agent that learns its own ordering: a chooser that learns which component comes next (thesis, 6.3.1).

Semi-Markov SARSA(λ) over a table: a decision lasts as long as what was decided takes, and the task's reward of that
time is its reward (Bradtke and Duff, 1995). What it may decide at all is not learned: see `Orderer.allowed`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from enum import IntEnum
from math import prod
from typing import Protocol

import numpy as np
from numpy.random import Generator

from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.learning import Sarsa
from rtagent.ordering import Ordering
from rtagent.policy import EpsilonGreedy
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, ORDER, WAIT, Component, Order, Situation
from rtagent.streams import restored_stream, save_stream


class Option(IntEnum):
    """What can be decided."""

    OBSERVE = 0
    ACT = 1
    LEARN = 2
    WAIT = 3


COMPONENTS: dict[Option, Order] = {
    Option.OBSERVE: (OBSERVE,),
    Option.ACT: (CHOOSE, ACT),
    Option.LEARN: (LEARN,),
    Option.WAIT: (WAIT,),
}
ENDS_CYCLE = (Option.ACT, Option.WAIT)


class Sight(IntEnum):
    """What there is to see: nothing new, a newer sample, an observation not chosen from, one that differs too."""

    NOTHING = 0
    OBSERVED = 1
    NEWS = 2
    CHANGE = 3


class Surroundings(Situation, Protocol):
    """What is asked of a run by a chooser that learns; all of it is known without waiting."""

    @property
    def reward(self) -> float:
        """The task's reward of the episode so far."""

    @property
    def urgency(self) -> Sequence[float]:
        """How urgent the newest observation is, as each gauge says."""

    @property
    def has_observed(self) -> bool:
        """Whether the episode has had an observation."""

    @property
    def fresh(self) -> bool:
        """Whether there is an observation newer than the last choice."""

    @property
    def change(self) -> bool:
        """Whether that observation differs, in its features, from the one that was chosen from last."""

    @property
    def news(self) -> bool:
        """Whether a sample waits that is newer than the newest observation."""

    @property
    def observable(self) -> bool:
        """Whether an observation would tell anything newer without waiting for it."""


KEPT = ("_state", "_option", "_decided_at", "_rewarded", "_acted_at")
"""What is saved of an episode as it is."""


class Orderer:
    """Chooses and learns; one for each trial. `rng` is its own random stream, drawn from by nothing else."""

    def __init__(self, ordering: Ordering, rng: Generator) -> None:
        self.ordering, self.rng = ordering, rng
        gauges = [gauge.bounds for gauge in ordering.urgency]
        self._bounds: tuple[Sequence[float], ...] = (*gauges, ordering.queue, ordering.age)
        self.shape = (*(len(bounds) + 1 for bounds in self._bounds), len(Sight))
        """How many bins there are of each gauge of urgency, of queue, age, and what there is to see."""
        size = prod(self.shape)
        self._features = [FeatureVector(np.array([place])) for place in range(size)]
        self._sarsa = Sarsa(
            size=size,
            actions=len(Option),
            alpha=ordering.alpha,
            gamma=ordering.gamma,
            gamma_per="second",
            lambda_=self._lambda,
            trace="replacing",
            initial=ordering.initial,
        )
        self._policy = EpsilonGreedy(epsilon=ordering.epsilon)
        self.begin(0)

    @property
    def values(self) -> FloatArray:
        """A copy of what it has learned, shape (options, *shape)."""
        return self._sarsa.weights.reshape(len(Option), *self.shape)

    def begin(self, now: int) -> None:
        """Begin an episode at `now` (ns)."""
        self._state = self._option = -1
        self._decided_at = self._acted_at = now
        self._rewarded = 0.0

    def cycle(self, situation: Surroundings) -> Iterator[Component]:
        """Yield components, each decision before them, until it has acted, has waited, or some time has passed."""
        began = situation.time
        while True:
            option = self.decide(situation)
            yield ORDER
            yield from COMPONENTS[option]
            if option in ENDS_CYCLE or situation.time - began >= self.ordering.look_within:
                return

    def decide(self, situation: Surroundings) -> Option:
        """Choose what comes next, and learn from what came of the last decision."""
        state, allowed = self.place(situation), self.allowed(situation)
        option = self._choose(state, allowed)
        if self._option >= 0:
            self._learn(situation, state, option)
        self._state, self._option = state, option
        self._decided_at, self._rewarded = situation.time, situation.reward
        if option is Option.ACT:
            self._acted_at = situation.time
        return option

    def end(self, situation: Surroundings, *, terminated: bool) -> None:
        """Learn from the last decision of an episode; where it was cut short, its return goes on."""
        if self._option < 0:
            return
        state = self.place(situation)
        option = Option.OBSERVE if terminated else self._choose(state, self.allowed(situation))
        self._learn(situation, state, option, terminated=terminated, truncated=not terminated)
        self._option = -1

    def place(self, situation: Surroundings) -> int:
        """Return the number of the bin, of all together, that a situation falls into."""
        age = situation.time - situation.observed_at
        place = 0
        gauged = (*situation.urgency, situation.queue_length, age)
        for bounds, value in zip(self._bounds, gauged, strict=True):
            place = place * (len(bounds) + 1) + bisect_right(bounds, value)
        return place * len(Sight) + _sight(situation)

    def allowed(self, situation: Surroundings) -> tuple[Option, ...]:
        """Return what may be decided; what is overdue leaves no choice."""
        now, rules = situation.time, self.ordering
        fresh = situation.fresh
        if now - self._acted_at >= rules.act_within:
            return (Option.ACT,) if fresh else (Option.OBSERVE,)
        if not situation.has_observed or now - situation.observed_at >= rules.look_within:
            return (Option.OBSERVE,)
        possible = (situation.observable, fresh, situation.queue_length > 0, not situation.news)
        return tuple(option for option in Option if possible[option]) or (Option.OBSERVE,)

    def save(self) -> Saved:
        """Return what it has learned, and where it is."""
        return save_fields(self, KEPT) | {"sarsa": self._sarsa.save(), "rng": save_stream(self.rng)}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it was of other bins."""
        self._sarsa.restore(saved["sarsa"])
        self.rng = restored_stream(saved["rng"])
        restore_fields(self, KEPT, saved)

    def _choose(self, state: int, allowed: tuple[Option, ...]) -> Option:
        if len(allowed) == 1:
            return allowed[0]
        values = self._sarsa.action_values(self._features[state])[list(allowed)]
        return allowed[self._policy.choose(values, self.rng)[0]]

    def _learn(
        self, situation: Surroundings, state: int, option: Option, *, terminated: bool = False, truncated: bool = False
    ) -> None:
        self._sarsa.update(
            Transition(
                self._features[self._state],
                self._option,
                1.0,
                situation.reward - self._rewarded,
                self._features[state],
                option,
                situation.time - self._decided_at,
                terminated,
                truncated,
            )
        )

    def _lambda(self, transition: Transition) -> float:
        return self.ordering.lambda_ ** (transition.elapsed / 1e9)


def _sight(situation: Surroundings) -> Sight:
    if situation.fresh and situation.change:
        return Sight.CHANGE
    if situation.news:
        return Sight.NEWS
    return Sight.OBSERVED if situation.fresh else Sight.NOTHING
