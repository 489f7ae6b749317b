"""How an agent learns its own ordering, as data: what it goes by, how it learns, and its bounds (thesis, 6.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

from rtagent.errors import ScheduleError
from rtagent.units import Duration, ms, second

CLOSED = {"extra": "forbid"}


def _check_bounds(name: str, bounds: Sequence[float]) -> None:
    if any(not low < high for low, high in pairwise(bounds)):
        raise ScheduleError(f"schedule.ordering.{name} is {list(bounds)}: give bounds that increase.")


@dataclass(frozen=True)
class Gauge:
    """Something that says how urgent an observation is: a demon's `prediction`, or a `signal`, "device.sensor".

    Without either it is the task's word: 1 or 0, and always 0 where the task says nothing. `bounds` part the values
    into bins.
    """

    __pydantic_config__: ClassVar = CLOSED

    signal: str = ""
    prediction: str = ""
    bounds: tuple[float, ...] = (0.5,)

    def __post_init__(self) -> None:
        if self.signal and self.prediction:
            raise ScheduleError("schedule.ordering.urgency has a signal and a prediction: give one of them.")
        _check_bounds("urgency.bounds", self.bounds)


@dataclass(frozen=True)
class Ordering:
    """Which component comes next is learned by SARSA(λ) over bins, rewarded by the task; times are in ns.

    It goes by how urgent the newest observation is (as each of `urgency` says), how many transitions wait (parted
    at `queue`), how old that observation is (at `age`), and what there is to see. `alpha` is the step size of all
    active features together, `gamma` is for each second, `lambda_` for each decision. In a state of so many visits
    it explores with probability n/(n + visits), n being `explored`, and never with less than `epsilon`. A wait
    lasts for `wait` at most. Whatever it has learned, it observes after `look_within`, and chooses and acts after
    `act_within`, at the latest.
    """

    __pydantic_config__: ClassVar = CLOSED

    urgency: tuple[Gauge, ...] = (Gauge(),)
    queue: tuple[int, ...] = (1, 4, 16)
    age: tuple[Duration, ...] = (5 * ms, 20 * ms)
    alpha: float = 0.2
    gamma: float = 0.1
    lambda_: float = 0.8
    epsilon: float = 0.003
    explored: float = 3.0
    wait: Duration = 5 * ms
    look_within: Duration = 100 * ms
    act_within: Duration = second

    def __post_init__(self) -> None:
        _check_bounds("queue", self.queue)
        _check_bounds("age", self.age)
        for name in ("wait", "look_within", "act_within"):
            if getattr(self, name) <= 0:
                raise ScheduleError(f"schedule.ordering.{name} is 0 or less: give a time above 0.")
        for name in ("gamma", "lambda_", "epsilon"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ScheduleError(f"schedule.ordering.{name} is {getattr(self, name)}: give 0 to 1.")
        for name in ("alpha", "explored"):
            if not getattr(self, name) > 0.0:
                raise ScheduleError(f"schedule.ordering.{name} is {getattr(self, name)}: give a number above 0.")
