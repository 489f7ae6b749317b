"""The two predictions on which what goes beyond the thesis is compared: of a finger (chapter 5), of a joint (4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import product
from typing import NamedTuple

from rtagent.experience import FloatArray
from rtagent.experiments.experiment import Cell, Options
from rtagent.experiments.grasping import ALPHA, ETA, TRAINED
from rtagent.experiments.representations.signals import BENTO
from rtagent.experiments.ring_finger import problem as ring_finger
from rtagent.experiments.streams import Returns, named, returns
from rtagent.specs import Spec

GRASPING, SORTING = "grasping", "sorting"
STREAMS = (GRASPING, SORTING)
UNITS = {GRASPING: "the sensor's range", SORTING: "the joint's range"}
DIMENSIONS, SORTING_GAMMA, SORTING_LAMBDA, SORTING_ALPHA = 8, 0.9, 0.99, 0.2
"""Of the sorting arm's prediction, as in section 4.3; α is what 8,000 prototypes have there all together."""
EVERY, QUICK_EVERY = 5, 25
"""Of the grasping stream every so manieth row is taken, with γ, λ and α for as many in one."""
ROWS = {GRASPING: 884_000, SORTING: 35_000}
"""About so many rows they have, to tell times beforehand."""
MODELLED = (
    "The streams are one of the simulated grasping experiment (docs/grasping.md), and one of the simulated "
    "sorting arm (docs/sorting.md); seeds are those of prototypes."
)


def cells(sizes: Sequence[int], seeds: int, options: Options) -> list[Cell]:
    """Return a cell for each stream, number of prototypes, and seed of these."""
    every = {GRASPING: QUICK_EVERY if options.quick else EVERY, SORTING: 1}
    return [
        {"stream": stream, "every": every[stream], "prototypes": size, "eta": ETA, "seed": seed}
        for stream, size, seed in product(STREAMS, sizes, range(seeds))
    ]


def rows_of(cell: Cell) -> float:
    """Return about how many rows a cell learns from."""
    return float(ROWS[cell["stream"]] / cell["every"])


class Problem(NamedTuple):
    """What is learned from what, and how: up to row `until`, and tested from row `tested` on.

    `states` has shape (rows, signals), with the ranges in `state`; `signal` is from 0 to 1, `truth` its return;
    `alpha` is the step size of all active features together.
    """

    states: FloatArray
    state: Mapping[str, Spec]
    signal: FloatArray
    truth: Returns
    gamma: float
    lambda_: float
    alpha: float
    until: int
    tested: int
    told: str

    @property
    def cumulants(self) -> FloatArray:
        """What is learned from each row on, normalised as the return."""
        return (1.0 - self.gamma) * self.signal


@lru_cache(maxsize=2)
def problem(stream: str, every: int) -> Problem:
    """Return what is to be predicted on a stream; of the grasping one every so manieth row is taken.

    As in chapter 5 nothing is learned while it is tested there; as in chapter 4 learning goes on for the arm.
    """
    return _grasping(every) if stream == GRASPING else _sorting()


def _grasping(every: int) -> Problem:
    """Return the problem of chapter 6, with γ, λ and α for as many rows in one."""
    states, state, signal, truth, gamma, lambda_, until, told = ring_finger.problem(every)
    alpha = 1.0 - (1.0 - ALPHA) ** every
    return Problem(states, state, signal, truth, gamma, lambda_, alpha, until, until, told)


def _sorting() -> Problem:
    stream, names = named("sorting"), BENTO.signals(DIMENSIONS)
    signal = stream.unit(BENTO.target)
    truth, tested = returns(signal, stream.last, SORTING_GAMMA), round(TRAINED * len(stream))
    rates = SORTING_GAMMA, SORTING_LAMBDA, SORTING_ALPHA
    return Problem(
        stream.states(names), stream.state(names), signal, truth, *rates, len(stream), tested, stream.told
    )
