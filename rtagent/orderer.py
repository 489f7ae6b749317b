"""An agent that learns its own ordering: a chooser that learns which component comes next (thesis, 6.3.1).

What it may decide at all is not learned: see `Orderer.allowed`.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from enum import IntEnum
from math import isfinite, prod
from typing import Protocol

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rtagent.experience import FloatArray
from rtagent.ordering import Ordering
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
LASTING = (Option.LEARN, Option.WAIT)
"""What goes on, slice after slice, until what the decision went by has changed."""
ENDS_CYCLE = (Option.ACT, Option.WAIT)


class Sight(IntEnum):
    """What there is to see: nothing new, an observation to choose from, a newer sample, a change to choose from."""

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


class OptionValues:
    """Semi-Markov SARSA(λ), linear in binned features, with replacing traces.

    A decision lasts as long as what was decided takes (Bradtke and Duff, 1995), so γ is for each second, and λ for
    each decision. A state, a bin of each axis of `shape`, has one feature for each of its bins and one for all of
    them together. Each has a weight for every option, and one that all options share: what makes a state good or
    bad whatever is done is learned once, and moves the values of options that were not tried lately too.
    """

    def __init__(self, shape: Sequence[int], options: int, alpha: float, gamma: float, lambda_: float) -> None:
        self._alpha, self._gamma, self._lambda = alpha / (2 * (len(shape) + 1)), gamma, lambda_
        self._shape, self._options = tuple(shape), options
        self._features = _features(self._shape)
        self.weights: FloatArray = np.zeros((int(self._features.max()) + 1, options + 1))
        self._trace: FloatArray = np.zeros_like(self.weights)

    def of(self, state: int) -> FloatArray:
        """Return the values of a state's options, shape (options,)."""
        summed = self.weights[self._features[state]].sum(axis=0)
        values: FloatArray = summed[:-1] + summed[-1]
        return values

    def update(self, state: int, option: int, reward: float, elapsed: int, following: float) -> float:
        """Learn from a decision that lasted `elapsed` (ns), `following` being the next one's value; return δ.

        Nothing is learned where that is not finite.
        """
        features, gamma = self._features[state], self._gamma ** (elapsed / 1e9)
        delta: float = reward + gamma * following - float(self.of(state)[option])
        if not isfinite(delta):
            return delta
        self._trace[features, option] = self._trace[features, -1] = 1.0
        self.weights += self._alpha * delta * self._trace
        self._trace *= gamma * self._lambda
        return delta

    def cut(self) -> None:
        """Reset the traces: an episode is over."""
        self._trace[:] = 0.0

    def save(self) -> Saved:
        """Return the state; see `rtagent.saving`."""
        return save_fields(self, ("weights", "_trace"))

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        restore_fields(self, ("weights", "_trace"), saved)


def _features(shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Return the features of every state, shape (states, len(shape) + 1)."""
    bins = np.stack(np.unravel_index(np.arange(prod(shape)), shape), axis=1)
    starts = np.cumsum([0, *shape])
    together = starts[-1] + np.arange(prod(shape))
    return np.column_stack([starts[:-1] + bins, together])


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
        self.values = OptionValues(self.shape, len(Option), ordering.alpha, ordering.gamma, ordering.lambda_)
        self._visits = np.zeros(prod(self.shape), np.int64)
        self.begin(0)

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
        """Say what comes next: what goes on, or, where something has changed, what is chosen and learned from."""
        state, allowed = self.place(situation), self.allowed(situation)
        if state == self._state and self._option in LASTING and self._option in allowed:
            return Option(self._option)
        option = self._choose(state, allowed)
        self._learn(situation, self._following(state, option))
        self._state, self._option = state, option
        self._decided_at, self._rewarded = situation.time, situation.reward
        if option is Option.ACT:
            self._acted_at = situation.time
        return option

    def end(self, situation: Surroundings, *, terminated: bool) -> None:
        """Learn from the last decision of an episode; where that was cut short, its return goes on."""
        self._learn(situation, 0.0 if terminated else float(self.values.of(self.place(situation)).max()))
        self.values.cut()
        self._option = -1

    def place(self, situation: Surroundings) -> int:
        """Return the number of the bin, of all together, that a situation falls into."""
        gauged = (*situation.urgency, situation.queue_length, situation.time - situation.observed_at)
        place = 0
        for bounds, value in zip(self._bounds, gauged, strict=True):
            place = place * (len(bounds) + 1) + bisect_right(bounds, value)
        return place * len(Sight) + _sight(situation)

    def allowed(self, situation: Surroundings) -> tuple[Option, ...]:
        """Return what may be decided; what is overdue, or did not reach the devices, leaves no choice."""
        now, rules = situation.time, self.ordering
        fresh, observable = situation.fresh, situation.observable
        act_is_due = situation.action_pending or now - self._acted_at >= rules.act_within
        if not situation.has_observed:
            return (Option.OBSERVE,)
        if act_is_due and fresh:
            return (Option.ACT,)
        if observable and (act_is_due or now - situation.observed_at >= rules.look_within):
            return (Option.OBSERVE,)
        possible = (observable, fresh, situation.queue_length > 0, not situation.news)
        return tuple(option for option in Option if possible[option]) or (Option.OBSERVE,)

    def save(self) -> Saved:
        """Return what it has learned, and where it is."""
        kept = save_fields(self, (*KEPT, "_visits"))
        return kept | {"values": self.values.save(), "rng": save_stream(self.rng)}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it was of other bins."""
        self.values.restore(saved["values"])
        self.rng = restored_stream(saved["rng"])
        restore_fields(self, (*KEPT, "_visits"), saved)

    def _choose(self, state: int, allowed: tuple[Option, ...]) -> Option:
        if len(allowed) == 1:
            return allowed[0]
        if self.rng.random() < self._epsilon(state):
            return allowed[int(self.rng.integers(len(allowed)))]
        values = self.values.of(state).tolist()
        return max(allowed, key=values.__getitem__)

    def _epsilon(self, state: int) -> float:
        """Return with which probability it explores, less in a state that it knows (Singh and others, 2000)."""
        self._visits[state] += 1
        begin = self.ordering.explored
        return max(self.ordering.epsilon, begin / (begin + float(self._visits[state])))

    def _following(self, state: int, option: Option) -> float:
        return float(self.values.of(state)[option])

    def _learn(self, situation: Surroundings, following: float) -> None:
        if self._option >= 0:
            reward, elapsed = situation.reward - self._rewarded, situation.time - self._decided_at
            self.values.update(self._state, self._option, reward, elapsed, following)


def _sight(situation: Surroundings) -> Sight:
    if situation.fresh and situation.change:
        return Sight.CHANGE
    if situation.news:
        return Sight.NEWS
    return Sight.OBSERVED if situation.fresh else Sight.NOTHING
