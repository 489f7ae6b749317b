"""The newest predictions of a Horde, as bytes: those of its groups one after the other."""

from __future__ import annotations

from rtagent.learning import Horde

MOST = 1000
"""Of a Horde of more demons only those are told that are measured."""


class Newest:
    """Reads what a Horde predicted last; `places` says which demons, in the order of the numbers."""

    def __init__(self, horde: Horde) -> None:
        self._all = len(horde) <= MOST
        self._groups = [(group.learned, group.watched) for group in horde.groups if self._all or len(group.watched)]
        self.precision = str(horde.groups[0].learned.estimate.dtype)
        self.places = [
            place
            for places, group in zip(horde.places, horde.groups, strict=True)
            for place in (places if self._all else [places[number] for number in group.watched])
        ]

    def __call__(self) -> bytes:
        """Return the predictions, about the next state of the transition that was learned last."""
        if self._all:
            return b"".join([learned.estimate.data for learned, _ in self._groups])
        return b"".join([learned.estimate[watched].data for learned, watched in self._groups])
