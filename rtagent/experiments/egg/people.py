"""The people of the trials with their attempts, and what is reckoned from them, with intervals over people."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experiments.egg.conditions import CONTROL, REACTIVE_SARSA, SARSA
from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.statistics import Interval, interval, paired

Times = NDArray[np.float64]
Person = Mapping[str, Any]

HALF_AN_EGG = 0.5
"""In place of none, where eggs are divided by."""


@dataclass(frozen=True)
class Group:
    """The people of one variant, each with a list of attempts as rows have them."""

    people: Sequence[Person]

    def rates(self, condition: str, last: int = 0) -> Times:
        """Return which part of each person's (`last`) attempts in a condition failed, shape (people,)."""
        attempts = (_of(person, condition)[-last:] for person in self.people)
        return np.array([np.mean([each["broken"] for each in those]) for those in attempts])

    def gaps(self, condition: str) -> Times:
        """Return each person's median time (s) from press to action in a condition, shape (people,)."""
        return np.array([np.median(_gaps(person, condition)) for person in self.people])

    def shorts(self, condition: str) -> Times:
        """Return each person's median distance (rad) from the whole eggs of a condition; NaN where none was."""
        whole = ([each["short"] for each in _of(person, condition) if not each["broken"]] for person in self.people)
        return np.array([np.median(distances) if distances else np.nan for distances in whole])

    def times(self, condition: str, event: str, people: Iterable[int] | None = None) -> Times:
        """Return all times (s) of an event, `pressed` or `acted`, in a condition, of these people or all."""
        chosen = self.people if people is None else [self.people[place] for place in people]
        return np.array(
            [each[event] for person in chosen for each in _of(person, condition) if each[event] is not None]
        )

    def of_people(self, statistic: Callable[[NDArray[np.intp]], float]) -> Interval:
        """Return a statistic of people, by their places, with its interval over people (and their episodes)."""
        return interval(range(len(self.people)), lambda drawn: np.float64(statistic(drawn.astype(np.intp))))


def _of(person: Person, condition: str) -> Sequence[Mapping[str, Any]]:
    return [each for each in person["attempts"] if each["condition"] == condition]


def _gaps(person: Person, condition: str) -> list[float]:
    both = ((each["pressed"], each["acted"]) for each in _of(person, condition))
    return [acted - pressed for pressed, acted in both if pressed is not None and acted is not None]


def grouped(pairs: Sequence[tuple[Cell, Row]]) -> dict[str, Group]:
    """Return the people of each variant."""
    people: dict[str, list[Person]] = defaultdict(list)
    for cell, row in pairs:
        people[cell["variant"]] += row["people"]
    return {variant: Group(each) for variant, each in people.items()}


def rate(group: Group, condition: str, last: int = 0) -> Interval:
    """Return which part of the stops (each person's `last`) failed, with its interval over people."""
    return interval(group.rates(condition, last))


def percent(found: Interval) -> str:
    """Return a part as a percentage with its interval."""
    return str(Interval(*(100 * end for end in (found.low, found.middle, found.high))))


def times_as_many(group: Group) -> Interval:
    """Return how many times as many stops failed with SARSA as with reactive SARSA, with its interval."""
    standard, reactive = (group.rates(condition) for condition in (SARSA, REACTIVE_SARSA))
    least = HALF_AN_EGG / (len(_of(group.people[0], REACTIVE_SARSA)) * len(group.people))
    return group.of_people(lambda drawn: standard[drawn].mean() / max(reactive[drawn].mean(), least))


def from_control(group: Group, last: int = 0) -> Interval:
    """Return how far reactive SARSA's failures are from those of control (its `last`), in parts of SARSA's."""
    control = group.rates(CONTROL, last)
    standard, reactive = (group.rates(each) for each in (SARSA, REACTIVE_SARSA))

    def share(drawn: NDArray[np.intp]) -> float:
        far = abs(standard[drawn].mean() - control[drawn].mean())
        return float(abs(reactive[drawn].mean() - control[drawn].mean()) / max(far, 1e-12))

    return group.of_people(share)


def trailing(group: Group, delay: float) -> Interval:
    """Return how much later, in learning delays, SARSA acts after a press than reactive SARSA does."""
    return paired(group.gaps(SARSA) / delay, group.gaps(REACTIVE_SARSA) / delay)
