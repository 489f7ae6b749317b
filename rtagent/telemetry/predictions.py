"""The newest predictions of a Horde, as bytes: those of its groups one after the other."""

from __future__ import annotations

from operator import attrgetter

from rtagent.learning import Horde

ESTIMATE = attrgetter("estimate")
MOST = 1000
"""Of a Horde of more demons only those are told that are measured."""


class Newest:
    """Reads what a Horde predicted last; `places` says which demons, in the order of the numbers."""

    def __init__(self, horde: Horde) -> None:
        self._all = len(horde) <= MOST
        told = [group for group in horde.groups if self._all or len(group.watched)]
        self._learned, self._watched = [group.learned for group in told], [group.watched for group in told]
        self.precision = str(horde.groups[0].learned.estimate.dtype)
        self.places = [
            place
            for places, group in zip(horde.places, horde.groups, strict=True)
            for place in (places if self._all else [places[number] for number in group.watched])
        ]

    def __call__(self) -> bytes:
        """Return the predictions, about the next state of the transition that was learned last."""
        if self._all:
            return b"".join(map(ESTIMATE, self._learned))
        parts = zip(self._learned, self._watched, strict=True)
        return b"".join([learned.estimate[watched].data for learned, watched in parts])
