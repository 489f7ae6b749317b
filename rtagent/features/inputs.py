"""What stands in front of a coder: a choice of signals, within their ranges, and traces of their history."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import ClassVar

import numpy as np

from rtagent.errors import SpecError, did_you_mean
from rtagent.experience import FeatureVector, FloatArray, IndexArray, State
from rtagent.features.coder import FeatureCoder, Moving, Remembering
from rtagent.features.normalise import Outside, UnitCube
from rtagent.saving import Saveable, Saved, restore_fields, restore_parts, save_fields, save_parts
from rtagent.specs import Spec


class DataTrace:
    """Summaries of the history of signals: T ← T · decay + S, beginning at 0 (thesis, section 2.3.4).

    `decay`, shape (traces,), is between 0 and 1; a trace reaches back about 1 / (1 - decay) observations.
    """

    def __init__(self, decay: Sequence[float] | FloatArray) -> None:
        self.decay: FloatArray = np.array(decay, dtype=np.float64)
        for each in self.decay.tolist():
            if not 0.0 < each < 1.0:
                raise SpecError(f"decay is {each}: give a number between 0 and 1.")
        self.values: FloatArray = np.zeros_like(self.decay)
        self._rest = 1.0 - self.decay

    def begin(self) -> None:
        """Forget the history."""
        self.values[:] = 0.0

    def add(self, signals: FloatArray) -> None:
        """Add the newest values, shape (traces,); raise `SpecError`, changing nothing, where one is not finite."""
        if not math.isfinite(signals @ signals):  # a sum of squares tells of each of them, and costs the least
            raise SpecError(f"a signal to be traced is not finite ({signals}): mask it, or leave it out.")
        self.values *= self.decay
        self.values += signals

    @property
    def normalised(self) -> FloatArray:
        """T · (1 - decay), shape (traces,): within the range from 0 to the signal's own ends."""
        return self.values * self._rest

    def save(self) -> Saved:
        """Return the traces."""
        return save_fields(self, ("values",))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of another number of traces."""
        restore_fields(self, ("values",), saved)


@dataclass(frozen=True)
class Traced:
    """Which signals are traced (patterns such as `"*.load"`; all that are chosen, if none are named), and how."""

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    decay: float
    signals: tuple[str, ...] = ()


class Inputs:
    """From the signals of a task to what a coder sees: those chosen, then traces, shape (len(specs),).

    `signals` are patterns over the names in `state` (all, if there are none). A signal comes in its own units,
    clipped or masked by its declared range as `outside` says; a trace, called NAME.trace(DECAY), is that of the
    signal normalised first: so its normalised form lies in the unit interval, whatever the range of the signal.
    Raises `SpecError` for a pattern that matches nothing and for a signal that has no finite range.
    """

    def __init__(
        self,
        state: Mapping[str, Spec],
        *,
        signals: Sequence[str] = (),
        traces: Sequence[Traced] = (),
        outside: Outside = "clip",
    ) -> None:
        chosen = matching(signals, state) if signals else list(state)
        traced = [
            (name, each.decay)
            for each in traces
            for name in (matching(each.signals, state) if each.signals else chosen)
        ]
        read = [name for name in state if name in chosen or name in dict(traced)]
        self._cube = UnitCube({name: state[name] for name in read}, outside)
        self.trace = DataTrace([decay for _, decay in traced])
        self.specs = _specs(state, chosen, traced)
        self._width = len(state)
        self._read = _places(read, list(state))
        self._chosen = np.array(_places(chosen, read), dtype=np.intp)
        self._traced = np.array(_places([name for name, _ in traced], read), dtype=np.intp)
        self._low, self._span = self._cube.low[self._traced], self._cube.span[self._traced]
        self._ones = np.ones(len(traced))

    def begin(self) -> None:
        """Begin an episode: what was before it may have been another world."""
        self.trace.begin()
        self._cube.last[:] = self._cube.low + self._cube.span / 2

    def __call__(self, state: State) -> FloatArray:
        """Return what the coder sees, and move the traces on: call it once for each observation.

        Raises `SpecError`, with the traces as they were, for another shape and for a NaN that is not masked.
        """
        inside = self._cube.inside(self._picked(state))
        signals = inside if len(inside) == len(self._chosen) else inside[self._chosen]
        if not self._ones.size:
            return signals
        unit = inside[self._traced]
        unit -= self._low
        unit /= self._span
        self.trace.add(unit)
        # rounding may carry a trace of a signal at its upper end beyond it
        return np.concatenate((signals, np.minimum(self.trace.normalised, self._ones)))

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values were clipped to their range, by signal."""
        return self._cube.clipped

    @property
    def masked(self) -> Mapping[str, int]:
        """How many values were disregarded, by signal."""
        return self._cube.masked

    def save(self) -> Saved:
        """Return the traces, the counts and the last values that were inside."""
        return save_parts(self._parts)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of other inputs."""
        restore_parts(self._parts, saved)

    @property
    def _parts(self) -> dict[str, Saveable]:
        return {"trace": self.trace, "cube": self._cube}

    def _picked(self, state: State) -> State:
        if len(self._read) == self._width:
            return state
        if len(state) != self._width:
            raise SpecError(f"the state has {len(state)} values: give one for each of {self._width} signals.")
        return [state[place] for place in self._read]


class Composed:
    """A coder behind its inputs: itself a coder. With `bias` a feature is added that is always active, the last.

    It remembers: `encode` moves the traces on, so each observation must be encoded once, and only once.
    """

    def __init__(self, inputs: Inputs, coder: FeatureCoder, *, bias: bool = False) -> None:
        self.inputs, self.coder = inputs, coder
        self.size, self.active = coder.size + bias, coder.active + bias
        if isinstance(coder, Moving):
            self.take_moves = coder.take_moves
        self._bias: IndexArray | None = np.array([coder.size], dtype=np.intp) if bias else None

    def begin(self) -> None:
        """Begin an episode: the traces begin anew."""
        self.inputs.begin()
        if isinstance(self.coder, Remembering):
            self.coder.begin()

    def encode(self, state: State) -> FeatureVector:
        """Return the features of `state`, shape (signals of the task,); raise `SpecError` as the parts do."""
        features = self.coder.encode(self.inputs(state))
        if self._bias is None:
            return features
        indices = np.concatenate((features.indices, self._bias))
        return FeatureVector(indices, None if features.values is None else np.append(features.values, 1.0))

    @property
    def clipped(self) -> Mapping[str, int]:
        """How many values were clipped to their range, by signal."""
        return self.inputs.clipped

    @property
    def masked(self) -> Mapping[str, int]:
        """How many values were disregarded, by signal."""
        return self.inputs.masked

    def save(self) -> Saved:
        """Return the state of the inputs, and that of the coder where it has any."""
        return save_parts(self._parts)

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; raise `SpecError` where it is of something else."""
        restore_parts(self._parts, saved)

    @property
    def _parts(self) -> dict[str, Saveable]:
        return {"inputs": self.inputs} | ({"coder": self.coder} if isinstance(self.coder, Saveable) else {})


def matching(patterns: Sequence[str], names: Mapping[str, object]) -> list[str]:
    """Return the names that match any of the patterns, in their own order; a name matches itself.

    Raises `SpecError` for a pattern that matches none.
    """
    found: set[str] = set()
    for pattern in patterns:
        matched = {name for name in names if name == pattern or fnmatchcase(name, pattern)}
        if not matched:
            raise SpecError(f"{pattern!r} matches no signal of the state{did_you_mean(pattern, list(names))}")
        found |= matched
    return [name for name in names if name in found]


def _specs(
    state: Mapping[str, Spec], chosen: Sequence[str], traced: Sequence[tuple[str, float]]
) -> dict[str, Spec]:
    specs = {name: state[name] for name in chosen}
    for name, decay in traced:
        title = f"{name}.trace({decay})"
        if title in specs:
            raise SpecError(f"there would be two inputs called {title!r}: trace each signal once with one decay.")
        specs[title] = Spec(low=0.0, high=1.0)
    return specs


def _places(names: Sequence[str], known: Sequence[str]) -> list[int]:
    return [known.index(name) for name in names]
