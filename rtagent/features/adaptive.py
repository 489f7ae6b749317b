"""Selective Kanerva coding whose prototypes move to where states are.

After the sparse distributed memories of Ratitch and Precup (2004) and of Ratitch, Mahadevan and Precup (2004),
which add a location where a state has none that is like it, and remove others when memory is full; and after visit
counts as a measure of what may go (Wu and Meleis 2009). Here as many prototypes as ever are active.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FeatureVector, FloatArray, IndexArray, Move, State
from rtagent.features.kanerva import SelectiveKanerva
from rtagent.features.prototypes import Distance, distances, lengths
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.specs import Spec

SAVED = ("prototypes", "visits", "_since", "_moves")


class Rules(NamedTuple):
    """When a prototype moves; see `AdaptiveKanerva`."""

    interval: int
    spacing: float
    rare: float


class AdaptiveKanerva:
    """The floor(K · eta) prototypes nearest to the state are active, and K of them follow the states.

    Once in `interval` observations one may move: the least visited prototype is removed, and one is added where the
    state is. It stays where the nearest prototype is closer than `spacing` already (in the unit cube), and where
    even the least visited has more than the part `rare` of all visits that it would have were they evenly spread.
    The new prototype takes the place of the farthest that was active; as a learner gives it that one's weight
    (`take_moves`), no prediction for the state changes. `prototypes`, `eta`, `distance` and `seed` as for
    `SelectiveKanerva`. Raises `SpecError` as that does, and for rules that cannot be.
    """

    def __init__(
        self,
        *,
        state: Mapping[str, Spec],
        prototypes: int | NDArray[np.float64] = 1000,
        eta: float = 0.025,
        interval: int = 100,
        spacing: float = 0.01,
        rare: float = 0.1,
        distance: Distance = "euclidean",
        seed: int = 0,
    ) -> None:
        self._rules = _checked(Rules(interval, spacing, rare))
        self._coder = SelectiveKanerva(state=state, prototypes=prototypes, eta=eta, distance=distance, seed=seed)
        self._distance = distance
        self.prototypes: FloatArray = self._coder.prototypes
        self.visits: FloatArray = np.zeros(len(self.prototypes))
        """How often each prototype was active; a new one has the visits of that whose place it took."""
        self.size, self.active = self._coder.size, self._coder.active
        self.interval = interval
        self._since, self._moves = 0, list[Move]()

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`, after moving a prototype if one is due; raise as the coder does."""
        features = self._coder.encode(state)
        self.visits[features.indices] += 1.0
        self._since += 1
        return features if self._since < self.interval else self._adapted(state, features)

    def encode_each(self, states: FloatArray) -> tuple[IndexArray, None]:
        """Return the features of successive states, a row each; no prototype moves, which `adapt` does."""
        indices, _ = self._coder.encode_each(states)
        self.visits += np.bincount(indices.ravel(), minlength=self.size)
        return indices, None

    def adapt(self, state: State) -> tuple[Move, ...]:
        """Move a prototype to a state, if the rules let one; return what has moved since this was last asked."""
        self._adapted(state, self._coder.encode(state))
        return self.take_moves()

    def take_moves(self) -> tuple[Move, ...]:
        """Return which features became others since this was last asked, each with that whose place it took."""
        moves, self._moves = tuple(self._moves), []
        return moves

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values lay outside their range, by signal."""
        return self._coder.clipped

    def save(self) -> Saved:
        """Return the prototypes, their visits, and the counts."""
        return save_fields(self, SAVED) | {"coder": self._coder.save()}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of other settings."""
        restore_fields(self, SAVED, saved)
        self._moves = [Move(*move) for move in self._moves]
        self._coder.restore(saved["coder"])
        self._coder.moved(np.arange(len(self.prototypes)))

    def _adapted(self, state: State, features: FeatureVector) -> FeatureVector:
        """Return the features of a state after a prototype has moved to it, or as they are."""
        self._since = 0
        point = self._coder.point(state)
        place = self._rarest(features.indices)
        if place is None or self._nearest(point, features.indices) < self._rules.spacing:
            return features
        self.prototypes[place] = point
        self._coder.moved(np.array([place]))
        found = self._coder.encode(state)
        (like,) = np.setdiff1d(features.indices, found.indices)
        self.visits[place] = self.visits[like]
        self._moves.append(Move(place, int(like)))
        return found

    def _rarest(self, active: IndexArray) -> int | None:
        """Return the least visited prototype that is not active, the first of several; None if it is not rare."""
        visits = self.visits.copy()
        visits[active] = inf
        place = int(visits.argmin())
        return place if visits[place] <= self._rules.rare * self.visits.mean() else None

    def _nearest(self, point: FloatArray, active: IndexArray) -> float:
        """Return how far the nearest prototype is."""
        measured = distances(self.prototypes[active], point, self._distance)
        return float(lengths(measured, self._distance).min())


def _checked(rules: Rules) -> Rules:
    if rules.interval < 1:
        raise SpecError(f"interval is {rules.interval}: give a number of observations, 1 or more.")
    if not 0.0 < rules.spacing < inf:
        raise SpecError(f"spacing is {rules.spacing}: give a distance above 0.")
    if not 0.0 <= rules.rare <= 1.0:
        raise SpecError(f"rare is {rules.rare}: give a part from 0 to 1.")
    return rules
