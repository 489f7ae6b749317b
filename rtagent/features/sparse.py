"""Sparse distributed memory over binary addresses (thesis, section 2.4; Kanerva 1988)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rtagent.errors import SpecError
from rtagent.experience import FloatArray, IndexArray
from rtagent.saving import Saved, restore_fields, save_fields


class SparseMemory:
    """Sparse distributed memory (thesis, section 2.4; Kanerva 1988): binary addresses, real values.

    `addresses` has shape (prototypes, bits), of 0 and 1; one is activated by an address at a Hamming distance
    below `radius`. Writing moves each activated value to the average of all that was written to it.
    """

    def __init__(self, addresses: NDArray[np.integer] | Sequence[Sequence[int]], radius: int) -> None:
        self._addresses = np.asarray(addresses)
        if self._addresses.ndim != 2 or not np.isin(self._addresses, (0, 1)).all():
            raise SpecError("addresses are rows of bits, 0 and 1: give an array of shape (prototypes, bits).")
        if radius < 1:
            raise SpecError(f"radius is {radius}: give a Hamming distance of 1 or more.")
        self._radius = radius
        self._sums: FloatArray = np.zeros(len(self._addresses))
        self._writes: FloatArray = np.zeros(len(self._addresses))

    def activated(self, address: NDArray[np.integer] | Sequence[int]) -> IndexArray:
        """Return the prototypes that `address`, shape (bits,), activates."""
        bits = np.asarray(address)
        if bits.shape != self._addresses.shape[1:]:
            raise SpecError(f"an address has shape {bits.shape}: give {self._addresses.shape[1]} bits.")
        return np.flatnonzero((self._addresses != bits).sum(axis=1) < self._radius)

    def write(self, address: NDArray[np.integer] | Sequence[int], value: float) -> None:
        """Write a value to every activated prototype."""
        places = self.activated(address)
        self._sums[places] += value
        self._writes[places] += 1

    def read(self, address: NDArray[np.integer] | Sequence[int]) -> float | None:
        """Return the average of the activated prototypes that were written to, or None where there are none."""
        places = self.activated(address)
        places = places[self._writes[places] > 0]
        return float(np.mean(self._sums[places] / self._writes[places])) if len(places) else None

    def save(self) -> Saved:
        """Return what was written."""
        return save_fields(self, ("_sums", "_writes"))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of other addresses."""
        restore_fields(self, ("_sums", "_writes"), saved)
