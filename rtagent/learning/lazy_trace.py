"""Many predictions that share one trace, at the speed of memory: the fast form of `shared_trace`.

Exact, but for rounding. Three things that the textbook's algorithm does to every weight are kept implicit:

- The trace is e = s·ê. Decay only changes the scalar s, and δe only adds δs to one number a demon, β:
  the weights are u + β·ê. (Where ê changes, by κ at each active feature, u is corrected by -κβ.)
- What is added to the weights of all active features alike, that correction and α(v̂ - v), is added to one
  number a demon, the offset o, until a feature becomes inactive.
- The sum of u over the active features, from which predictions follow, is kept up as features come and go.

So a step of binary features touches only the weights of those that became active or inactive, one contiguous row
each. Where most do, or features have values, all active rows are touched. When s becomes small, β is put into the
weights of the features with a trace (a fold), before digits are lost.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtagent import kernels
from rtagent.experience import FeatureVector, FloatArray, IndexArray
from rtagent.learning.cumulants import Cumulants
from rtagent.learning.shared_trace import (
    NOTHING,
    Precision,
    SharedTrace,
    Step,
    TraceGroup,
    Vector,
    refuse_unknown,
    restored_features,
    same_features,
    save_features,
)
from rtagent.saving import Saved, restore_fields, save_fields

SMALLEST_SCALE = {"float32": 2e-3, "float64": 1e-5}
"""A fold is due when s falls under this: it costs as many digits."""

LEAST_TRACE = {"float32": 1e-6, "float64": 1e-17}
"""A trace under this part of the step size is forgotten at a fold."""

SLICE_BYTES = 1_000_000
"""A slice moves about so many bytes, which takes some 50 µs."""

OVERLAP, TRACE_HERE = 2, 4
"""Places in what `compare` finds."""

VECTOR_BYTES = 64
"""What a demon's own numbers are worth, in the bytes of a slice."""

LEAST_SLICE = 32
FOLD_DEMONS = 4096
"""A fold goes through the rows of so many demons at a time."""

SAVED = (
    "_table", "total", "beta", "offset", "estimate", "_trace", "_support", "_count", "_scale", "_decay", "_fresh",
    "_listed",
)  # fmt: skip


class _Segment(NamedTuple):
    """The demons up to `end`: their offset is due to `active`, their β to the trace and `factor` times `extra`."""

    end: int
    active: FeatureVector
    extra: FeatureVector = NOTHING
    factor: float = 0.0


class LazyTrace:
    """Demons that share a trace; `cumulants` is what they predict, `alpha` the step size of each weight."""

    def __init__(
        self, size: int, cumulants: Cumulants, alpha: float, precision: Precision, compiled: ModuleType
    ) -> None:
        demons = len(cumulants)
        self.cumulants, self._alpha, self._kernels = cumulants, alpha, compiled
        self.slice_bytes = SLICE_BYTES
        self._smallest, self._least = SMALLEST_SCALE[precision], LEAST_TRACE[precision] * alpha
        # written to, as np.zeros is not: the first touch of a page, in a run, would take up to milliseconds
        self._table: NDArray[Any] = np.full((size, demons), 0.0, precision)
        self.total, self.beta, self.offset, self.estimate = np.zeros((4, demons), precision)
        self.delta, self.cumulant = np.zeros((2, demons), precision)
        self._trace: FloatArray = np.zeros(size)
        self._support: NDArray[np.int64] = np.zeros(size, dtype=np.int64)
        self._listed = np.zeros(size, dtype=np.bool_)
        self._count, self._scale, self._decay, self._fresh = 0, 1.0, 0.0, True
        self._here = NOTHING
        self._marks, self._others = np.zeros((2, size))
        self._left, self._entered = np.zeros((2, size), dtype=np.int64)
        self._found = np.zeros(6)
        self._ones, self._nothing = np.ones(size), np.zeros(0, precision)
        self._p = np.zeros(10, precision)
        self._segments: list[_Segment] = []

    @property
    def weights(self) -> NDArray[Any]:
        """The weights, shape (size, demons), put together."""
        weights = self._table.copy()
        eligible = self._support[: self._count]
        weights[eligible] += np.outer(self._trace[eligible], self.beta).astype(weights.dtype)
        weights[self._here.indices] += np.outer(self._numbers(self._here), self.offset).astype(weights.dtype)
        return weights

    def predict(self, features: FeatureVector) -> Vector:
        """Return the predictions, shape (demons,)."""
        return self.predict_some(features, 0, len(self.estimate))

    def predict_some(self, features: FeatureVector, first: int, end: int) -> Vector:
        """Return the predictions of the demons from `first` up to `end`."""
        out = np.empty_like(self.estimate)
        begin = 0
        for segment in [*self._segments, _Segment(len(out), self._here)]:
            low, high = max(first, begin), min(end, segment.end)
            if low < high:
                self._predict(_writable(features), segment, out, low, high)
            begin = max(begin, segment.end)
        return out[first:end]

    def updating(self, step: Step) -> Generator[None, None, None]:
        """Learn a step, a few demons at a time."""
        features = _writable(step.features)
        if not self._kernels.known(step.next_features.indices, len(self._trace)):
            refuse_unknown((step.next_features,), len(self._trace))
        if not same_features(features, self._here):  # what came before is not known: the trace is cut here
            refuse_unknown((features,), len(self._trace))
            yield from self._settle(features, 0.0)
            self._fresh = True
        elif self._count and self._scale * self._decay < self._smallest:
            yield from self._settle(features, self._scale * self._decay)
        elif self._count:
            self._scale *= self._decay
        yield from self._learn(step)
        self._decay, self._fresh = step.decay, False
        if step.last:
            yield from self._settle(self._here, 0.0)
            self._fresh = True

    def _learn(self, step: Step) -> Generator[None, None, None]:
        here, scale = self._here, self._scale
        there = _writable(step.next_features)
        lefts, enters, overlap, squares, trace_here, trace_there = self._compare(here, there)
        amount = self._alpha * (1.0 - scale * trace_here)
        direct = amount if step.decay == 0.0 and self._count == 0 else 0.0
        kappa = 0.0 if direct else amount / scale
        binary = here.values is None and there.values is None
        changes = binary and 2 * (lefts + enters) < 2 * len(here.indices) + len(there.indices)
        self._p[:] = (
            step.gamma, self._alpha, kappa, 0.0 if direct else scale, squares, overlap, trace_here, trace_there,
            self._fresh, direct,
        )  # fmt: skip
        rows = (
            (self._left[: int(lefts)].copy(), self._nothing, self._entered[: int(enters)].copy(), self._nothing)
            if changes
            else (here.indices, self._weights(here), there.indices, self._weights(there))
        )
        learn = self._kernels.step_by_changes if changes else self._kernels.step_by_rows
        vectors = (self._table, self.total, self.beta, self.offset, self.estimate, self.cumulant, self.delta)
        yield  # what has been prepared is a slice of its own
        for first, end in self._slices(2 * (len(rows[0]) + len(rows[2]))):
            self.cumulants.fill(step.signals, step.scale, self.cumulant, first, end)
            learn(*vectors, *rows, self._p, first, end)
            self._segments = [_Segment(end, there, here, kappa)]
            yield
        if kappa:
            self._count = self._kernels.extend_trace(
                here.indices, self._numbers(here), kappa, self._trace, self._support, self._listed, self._count
            )
        self._here, self._segments = there, []

    def _settle(self, there: FeatureVector, scale: float) -> Generator[None, None, None]:
        """Put all that is implicit into the weights, go over to the features `there`, and scale the trace."""
        support = self._support[: self._count].copy()
        folded, here = FeatureVector(support, self._trace[support]), self._here
        for first in range(0, len(self.estimate), FOLD_DEMONS):
            end = min(first + FOLD_DEMONS, len(self.estimate))
            some = slice(first, end)
            done = _Segment(first, NOTHING)
            for done_rows, rows in self._rows(folded, end - first):
                self._kernels.add_to_rows(self._table, self.beta, *rows, first, end)
                self._segments = [done, _Segment(end, here, done_rows, -1.0)]
                yield
            self.beta[some] = 0.0
            for done_rows, rows in self._rows(here, end - first):
                self._kernels.add_to_rows(self._table, self.offset, *rows, first, end)
                self._segments = [done, _Segment(end, _rest(here, done_rows))]
                yield
            self.offset[some] = self.total[some] = 0.0
            self._segments = [_Segment(end, NOTHING)]
            for _, rows in self._rows(there, end - first):
                self._kernels.sum_rows(self._table, self.total, *rows, first, end)
                yield
        self._count = self._kernels.shrink_trace(
            self._trace, self._support, self._listed, self._count, scale, self._least
        )
        self._scale, self._here, self._segments = 1.0, there, []

    def _rows(
        self, features: FeatureVector, demons: int
    ) -> Iterator[tuple[FeatureVector, tuple[IndexArray, Vector]]]:
        """Yield the rows of `features`, some at a time, and all up to these."""
        each = max(1, self.slice_bytes // (2 * demons * self.estimate.itemsize))
        values = self._numbers(features)
        for first in range(0, len(features.indices), each):
            some, done = slice(first, first + each), slice(0, first + each)
            rows = features.indices[some], values[some].astype(self.estimate.dtype)
            yield FeatureVector(features.indices[done], values[done]), rows

    def _predict(self, features: FeatureVector, segment: _Segment, out: Vector, first: int, end: int) -> None:
        found, of = self._compare(features, segment.active), out.dtype.type
        extra = segment.factor * self._compare(features, segment.extra)[OVERLAP] if segment.factor else 0.0
        self._kernels.predict(
            self._table, self.beta, self.offset, features.indices, self._weights(features), of(found[OVERLAP]),
            of(found[TRACE_HERE] + extra), out, first, end,
        )  # fmt: skip

    def _compare(self, here: FeatureVector, there: FeatureVector) -> list[float]:
        known = self._kernels.compare(
            here.indices, self._numbers(here), there.indices, self._numbers(there), self._trace,
            self._marks, self._others, self._left, self._entered, self._found,
        )  # fmt: skip
        if not known:
            refuse_unknown((here, there), len(self._trace))
        found: list[float] = self._found.tolist()
        return found

    def _numbers(self, features: FeatureVector) -> FloatArray:
        return self._ones[: len(features.indices)] if features.values is None else features.values

    def _weights(self, features: FeatureVector) -> Vector:
        """Return the values of features in the precision of the weights."""
        return self._numbers(features).astype(self.estimate.dtype)

    def _slices(self, touches: int) -> list[tuple[int, int]]:
        """Cut the demons into slices of about the same work, each demon with so many touches of weights."""
        demons = len(self.estimate)
        each = max(LEAST_SLICE, self.slice_bytes // (touches * self.estimate.itemsize + VECTOR_BYTES))
        return [(first, min(first + each, demons)) for first in range(0, demons, each)]

    def inherit(self, place: int, like: int) -> None:
        """Give feature `place`, which has become another, the weight of feature `like`, and no trace."""
        if place in self._here.indices:  # what is implicit is of all that is active
            for _ in self._settle(self._here, self._scale):
                pass
        row = self._table[like] + (self._trace[like] * self.beta).astype(self._table.dtype)
        here = self._here.indices == like
        row += (self._numbers(self._here)[here].sum() * self.offset).astype(row.dtype)
        self._table[place], self._trace[place] = row, 0.0
        if place in self._here.indices:
            for _ in self._settle(self._here, self._scale):
                pass

    def save(self) -> Saved:
        """Return the state, exactly; not to be called in the middle of a step."""
        return save_fields(self, SAVED) | save_features(self._here)

    def restore(self, saved: Saved) -> None:
        """Take a saved state."""
        restore_fields(self, SAVED, saved)
        self._here = restored_features(saved)


def shared_trace(size: int, cumulants: Cumulants, alpha: float, precision: Precision) -> TraceGroup:
    """Return a group in its fast form, or in the plain one where there is no compiler."""
    compiled = kernels.load("shared_trace")
    if compiled is None:
        return SharedTrace(size, cumulants, alpha, precision)
    return LazyTrace(size, cumulants, alpha, precision, compiled)


def _rest(features: FeatureVector, done: FeatureVector) -> FeatureVector:
    """Return the features that come after those that are done."""
    count = len(done.indices)
    return FeatureVector(features.indices[count:], None if features.values is None else features.values[count:])


def _writable(features: FeatureVector) -> FeatureVector:
    """Return features whose arrays the kernels take: they were compiled for arrays that can be written to."""
    if features.indices.flags.writeable and (features.values is None or features.values.flags.writeable):
        return features
    return FeatureVector(features.indices.copy(), None if features.values is None else features.values.copy())
