"""How good predictions turned out: true returns, known only later, and the errors against them."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtagent.experience import FloatArray, IndexArray
from rtagent.memory import claim
from rtagent.saving import Saved, restore_fields, save_fields

TOLERANCE = 1e-3
"""A return is known once what is still to come weighs less than this in it."""

MOST_PENDING = 100_000
"""Predictions that have waited for their return behind so many others are given up, and counted."""

LEAST_TRACE = 1e-6
SMALLEST_SCALE = 1e-100

SLICE = 32
"""So many steps of a return are summed up at a time, which takes some 50 µs."""


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of a demon's predictions against the returns that followed: mean absolute, root mean square (or None).

    `rupee` is its projected error by its own trace, where that was asked for; `verified` how many predictions
    were compared, `unverified` how many never had a known return.
    """

    mae: float | None
    rmse: float | None
    rupee: float | None
    verified: int
    unverified: int


class _Block:
    """Up to `SLICE` steps in a row: what was predicted, and the cumulants and γ that came next.

    In a few large arrays, because thousands of small objects would keep the collector of garbage busy.
    """

    def __init__(self, demons: int) -> None:
        self.predictions, self.cumulants = np.empty((2, SLICE, demons))
        self.gammas: list[float] = []

    def add(self, prediction: FloatArray, cumulant: FloatArray, gamma: float) -> None:
        """Add a step."""
        self.predictions[len(self.gammas)], self.cumulants[len(self.gammas)] = prediction, cumulant
        self.gammas.append(gamma)

    def returns(self, following: FloatArray) -> FloatArray:
        """Return the returns from each step on, shape (steps, demons); `following` is that after the last."""
        returns = np.empty((len(self.gammas), len(following)))
        for place in range(len(returns) - 1, -1, -1):
            following = np.add(self.cumulants[place], self.gammas[place] * following, out=returns[place])
        return returns


class Verifier:
    """Compares the predictions of a few demons, which share γ, with their returns, once these are known."""

    def __init__(self, demons: int) -> None:
        self.absolute, self.squared = np.zeros((2, demons))
        self.verified = self.unverified = 0
        self._older: list[_Block] = []
        self._newer: list[_Block] = []
        self._weight = 1.0

    def add(
        self, prediction: FloatArray, cumulant: FloatArray, gamma: float, last: bool
    ) -> Generator[None, None, None]:
        """Take a prediction, the cumulant (shape (demons,)) that came next and γ there; work in slices."""
        if not self._newer or len(self._newer[-1].gammas) == SLICE:
            self._newer.append(_Block(len(self.absolute)))
        self._newer[-1].add(prediction, cumulant, gamma)
        self._weight *= gamma
        if self._weight < TOLERANCE or last:
            yield from self._verify(last)
        elif len(self._newer) * SLICE >= MOST_PENDING and len(self._newer[-1].gammas) == SLICE:
            self.unverified += sum(len(block.gammas) for block in self._older)
            self._older, self._newer, self._weight = self._newer, [], 1.0

    def _verify(self, last: bool) -> Generator[None, None, None]:
        """Compare what is older, and, where there is no more to come, what is newer."""
        blocks, newer = self._older + self._newer, 0 if last else len(self._newer)
        self._older, self._newer, self._weight = self._newer[len(self._newer) - newer :], [], 1.0
        following, weight = np.zeros_like(self.absolute), 1.0
        for number, block in enumerate(reversed(blocks)):
            returns = block.returns(following)
            weights = weight * np.cumprod(block.gammas[::-1])[::-1]
            following, weight = returns[0], float(weights[0])
            if number >= newer:
                self._compare(block.predictions[: len(returns)] - returns, weights < TOLERANCE)
            yield

    def _compare(self, errors: FloatArray, known: NDArray[np.bool_]) -> None:
        """Add up the errors of those steps, shape (steps, demons), whose return is known."""
        count = int(np.count_nonzero(known))
        self.verified += count
        self.unverified += len(known) - count
        errors = errors[known]
        self.absolute += np.abs(errors).sum(axis=0)
        self.squared += (errors * errors).sum(axis=0)

    def errors(self, rupees: Sequence[float] | None = None) -> list[PredictionErrors]:
        """Return the errors of each demon."""
        known = rupees if rupees is not None else [None] * len(self.absolute)
        if not self.verified:
            return [PredictionErrors(None, None, rupee, 0, self.unverified) for rupee in known]
        means, squares = self.absolute / self.verified, self.squared / self.verified
        return [
            PredictionErrors(mean, math.sqrt(square), rupee, self.verified, self.unverified)
            for mean, square, rupee in zip(means.tolist(), squares.tolist(), known, strict=True)
        ]

    def save(self) -> Saved:
        """Return the sums and what is still pending."""
        saved = save_fields(self, ("absolute", "squared", "verified", "unverified", "_weight"))
        return saved | {"older": self._packed(self._older), "newer": self._packed(self._newer)}

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        restore_fields(self, ("absolute", "squared", "verified", "unverified", "_weight"), saved)
        self._older, self._newer = self._unpacked(saved["older"]), self._unpacked(saved["newer"])

    def _packed(self, blocks: Sequence[_Block]) -> Saved:
        nothing = np.zeros((0, len(self.absolute)))
        return {
            "prediction": np.concatenate([nothing, *(block.predictions[: len(block.gammas)] for block in blocks)]),
            "cumulant": np.concatenate([nothing, *(block.cumulants[: len(block.gammas)] for block in blocks)]),
            "gamma": np.array([gamma for block in blocks for gamma in block.gammas]),
        }

    def _unpacked(self, saved: Saved) -> list[_Block]:
        blocks: list[_Block] = []
        for place, gamma in enumerate(saved["gamma"].tolist()):
            if place % SLICE == 0:
                blocks.append(_Block(len(self.absolute)))
            blocks[-1].add(saved["prediction"][place], saved["cumulant"][place], gamma)
        return blocks


class Rupee:
    """Recent unsigned projected error estimate of a few demons (White 2015, Developing a predictive approach).

    RUPEE = sqrt(|hᵀ E[δe]|): h estimates by least squares the projection of δe on the features, at step size
    `alpha`; the average forgets at the rate `beta`. The trace e accumulates. Only its rows are touched.
    """

    def __init__(self, size: int, demons: int, alpha: float, beta: float = 1e-3) -> None:
        claim(16 * size * demons, f"the projected errors of {demons} demons")
        self.h, self._average = np.zeros((2, size, demons))
        self._trace = np.zeros(size)
        self._alpha, self._beta, self._scale, self._bias = alpha, beta, 1.0, 1.0

    def add(self, indices: IndexArray, values: FloatArray, delta: FloatArray, decay: float) -> None:
        """Take one step: the features of the state, delta, shape (demons,), and γλ of the next (0: none)."""
        self._trace[indices] += values
        rows = np.flatnonzero(np.abs(self._trace) > LEAST_TRACE)
        credit = np.outer(self._trace[rows], delta)
        projected = values @ self.h[indices]
        self.h[rows] += self._alpha * credit
        self.h[indices] -= self._alpha * np.outer(values, projected)
        self._scale *= 1.0 - self._beta  # the average is _scale times _average: only the rows change
        self._bias *= 1.0 - self._beta
        self._average[rows] += (self._beta / self._scale) * credit
        self._trace *= decay
        if self._scale < SMALLEST_SCALE:
            self._average *= self._scale
            self._scale = 1.0

    def values(self) -> list[float]:
        """Return RUPEE of each demon; the average is corrected for having begun at 0."""
        if self._bias == 1.0:
            return [0.0] * self.h.shape[1]
        average = self._average * (self._scale / (1.0 - self._bias))
        found: list[float] = np.sqrt(np.abs((self.h * average).sum(axis=0))).tolist()
        return found

    def save(self) -> Saved:
        """Return the state."""
        return save_fields(self, ("h", "_average", "_trace", "_scale", "_bias"))

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        restore_fields(self, ("h", "_average", "_trace", "_scale", "_bias"), saved)
