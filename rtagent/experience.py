"""What an agent experiences: samples, observations, outcomes, feature vectors, transitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rtagent.specs import Value

IndexArray = NDArray[np.intp]
FloatArray = NDArray[np.float64]
State = Sequence[float] | FloatArray
"""The values of a task's state signals, in the order in which the task names them."""
Values = Mapping[str, "Value"]
Command = Mapping[str, "Value"]
TimeSource = Literal["truth", "device", "arrival"]


class Sample(NamedTuple):
    """The values of one device at one moment.

    `world_time` (ns) is when the world was so, `arrival_time` (ns) when the host had it; `time_source` says
    whether `world_time` is the truth of a fake, the device's own fitted clock, or only the arrival.
    """

    values: Values
    world_time: int
    arrival_time: int
    sequence: int
    time_source: TimeSource = "truth"


class Stimulus(NamedTuple):
    """A change of the world that calls for a reaction, with its true time (ns)."""

    time: int
    kind: str = "stimulus"
    time_source: TimeSource = "truth"


class Observation(NamedTuple):
    """What the agent knows at `time` (ns): the newest sample of every device, by the device's name.

    `stale` names the devices whose sample is older than their declared limit.
    """

    time: int
    samples: Mapping[str, Sample]
    stale: frozenset[str] = frozenset()

    def age(self, device: str) -> int:
        """Return how old (ns) the newest sample of `device` is."""
        return self.time - self.samples[device].world_time


class Outcome(NamedTuple):
    """A task's reading of an observation: state, reward since the last one, and whether the episode ends."""

    state: State
    reward: float = 0.0
    terminated: bool = False
    truncated: bool = False


class FeatureVector(NamedTuple):
    """Features of one state: the active `indices`, each once, and their `values` (None: all are 1)."""

    indices: IndexArray
    values: FloatArray | None = None


class Move(NamedTuple):
    """A feature that has become another: feature `place`, whose weight is now to be that of feature `like`."""

    place: int
    like: int


@dataclass(slots=True)
class Transition:
    """What learning needs of one step.

    `features` and `next_features` are as they were when observed, and so are `state` and `next_state`, the
    signals that they were made from (cumulants and continuations read them); `action` and `next_action` are None in
    a run that only predicts, `next_action` also where the learner does not need it. `elapsed` is in ns, and so is
    `complete_at`, the time of the observation with which it was complete.
    A truncated transition does not end the return: it bootstraps from `next_features`.
    `moves` are of features that became others up to `next_features`, since the transition before: they come first.
    """

    features: FeatureVector
    action: int | None
    probability: float
    reward: float
    next_features: FeatureVector
    next_action: int | None
    elapsed: int
    terminated: bool
    truncated: bool
    state: State = ()
    next_state: State = ()
    complete_at: int = 0
    moves: tuple[Move, ...] = ()

    @property
    def last(self) -> bool:
        """Whether the episode ended with it, so that traces are reset once it is learned."""
        return self.terminated or self.truncated
