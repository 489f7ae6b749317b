"""What a feature coder is."""

from __future__ import annotations

from typing import Protocol

from rtagent.experience import FeatureVector, State


class FeatureCoder(Protocol):
    """Turns states into feature vectors.

    `size` is the number of features, `active` how many of them are non-zero at a time (at most). A vector
    that `encode` returned is never written to again: transitions keep it.
    """

    size: int
    active: int

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`; raise `SpecError` where a value is outside its range."""
