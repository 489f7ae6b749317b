"""Policies: from action values to an action and the probability with which it was chosen."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.random import Generator

from rtagent.errors import SpecError
from rtagent.experience import FloatArray


class Policy(Protocol):
    """Chooses actions."""

    def choose(self, action_values: FloatArray, rng: Generator) -> tuple[int, float]:
        """Return an action and its probability; `action_values` has shape (actions,)."""

    def probabilities(self, action_values: FloatArray) -> FloatArray:
        """Return the probability of every action, shape (actions,), summing to 1."""


class Greedy:
    """The action of the highest value; among equals each is as likely."""

    def choose(self, action_values: FloatArray, rng: Generator) -> tuple[int, float]:
        """Return a best action; nothing is drawn from `rng` where there is only one."""
        values = action_values.tolist()  # for a few actions a list is ten times quicker than an array
        highest = max(values)
        best = [action for action, value in enumerate(values) if value == highest]
        if len(best) == 1:
            return best[0], 1.0
        return best[int(rng.integers(len(best)))], 1.0 / len(best)

    def probabilities(self, action_values: FloatArray) -> FloatArray:
        """Return the uniform distribution over the best actions."""
        best: FloatArray = (action_values == action_values.max()).astype(np.float64)
        best /= best.sum()
        return best


class EpsilonGreedy:
    """Any action with probability `epsilon` (0 to 1), else a best one (Sutton and Barto, section 2.2)."""

    def __init__(self, *, epsilon: float = 0.1) -> None:
        if not 0.0 <= epsilon <= 1.0:
            raise SpecError(f"epsilon is {epsilon}: give a probability from 0 to 1.")
        self.epsilon = epsilon
        self._greedy = Greedy()

    def choose(self, action_values: FloatArray, rng: Generator) -> tuple[int, float]:
        """Return an action and the probability that this policy gives it."""
        if self.epsilon and rng.random() < self.epsilon:
            action = int(rng.integers(action_values.size))
        else:
            action, _ = self._greedy.choose(action_values, rng)
        return action, float(self.probabilities(action_values)[action])

    def probabilities(self, action_values: FloatArray) -> FloatArray:
        """Return epsilon shared by all actions and the rest shared by the best."""
        greedy = self._greedy.probabilities(action_values)
        return (1.0 - self.epsilon) * greedy + self.epsilon / action_values.size
