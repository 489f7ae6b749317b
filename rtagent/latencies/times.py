"""Times that a run took, by what they are of; what too few of them cannot say is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from rtagent.errors import SpecError, UndecidedError, did_you_mean
from rtagent.result import Result
from rtagent.schedule import Component
from rtagent.units import describe

PARTS = ("sensing", "deciding", "acting")
AGE = "sample age"
SLICES_KEPT = 0.99


@dataclass(frozen=True)
class Times:
    """Times (ns) of one thing, such as reactions; `name` says of what, `run` of which run."""

    name: str
    values: Sequence[int]
    run: str = "the run"

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.values)

    @property
    def maximum(self) -> int:
        """The longest (ns); raises `UndecidedError` where there is none."""
        self.need(1, "a maximum")
        return max(self.values)

    @property
    def median(self) -> float:
        """The median (ns); raises `UndecidedError` where there is none."""
        return self.quantile(0.5)

    def quantile(self, q: float) -> float:
        """Return a quantile (ns), 0 < q < 1; raises `UndecidedError` where too few times lie beyond it."""
        if not 0 < q < 1:
            raise SpecError(f"the quantile {q} is not between 0 and 1: 0.99 is the p99; the longest is `maximum`.")
        self.need(needed(q), f"the quantile {q}")
        return float(np.quantile(np.asarray(self.values), q))

    def need(self, least: int, what: str) -> None:
        """Raise `UndecidedError` unless there are at least so many."""
        if self.count < least:
            raise UndecidedError(
                f"{self.run} has {self.count} times of {self.name}, and {what} needs {least}: run more episodes."
            )


def needed(q: float) -> int:
    """Return how many times a quantile needs: one beyond it, on either side."""
    return ceil(round(1 / min(q, 1 - q), 9))


class Measured:
    """The times of a run by name: reaction, its parts, response, the components, slice, sample age."""

    def __init__(self, result: Result, run: str = "the run") -> None:
        self.result, self._run = result, run
        self._times = {name: Times(name, values, run) for name, values in times_of(result).items()}

    def __getitem__(self, name: str) -> Times:
        """Return the times of that name; raises `SpecError` where there is no such name."""
        if name not in self._times:
            raise SpecError(f"there are no times of {name!r}{did_you_mean(name, list(self._times))}")
        return self._times[name]

    @property
    def reaction(self) -> Times:
        """The reaction times."""
        return self["reaction"]

    def assert_at_most(self, limit: int, name: str = "reaction", *, least: int = 1, missed: int = 0) -> None:
        """Fail where any time of that name is longer than `limit` (ns), or too many stimuli had no reaction.

        Raises `AssertionError` with a sentence that says which part, and which component, took longest, and
        `UndecidedError` where there are fewer than `least` times. More than `missed` stimuli without any reaction
        before their episode ended are an error too: they would be later than the limit.
        """
        __tracebackhide__ = True
        times = self[name]
        unanswered = self.result.reaction_time.missed if name == "reaction" else 0
        late = sum(value > limit for value in times.values)
        if late or unanswered > missed:
            raise AssertionError(self._said(times, limit, late, unanswered))
        times.need(max(1, least), f"a limit of {describe(limit)}")

    def _said(self, times: Times, limit: int, late: int, missed: int) -> str:
        lines = []
        if late:
            over = describe(times.maximum - limit)
            lines += [
                f"{self._run}: {late} of {times.count} times of {times.name} are longer than {describe(limit)}; "
                f"the longest is {describe(times.maximum)}, {over} too long."
            ]
        if missed:
            lines += [f"{self._run}: {missed} stimuli had no reaction before their episode ended."]
        if late and times.name == "reaction":
            lines += [self._parts_said(), self._components_said()]
        return "\n".join(lines)

    def _parts_said(self) -> str:
        reactions = [each for episode in self.result.episodes for each in episode.reactions.reactions]
        longest = max(reactions, key=lambda reaction: reaction.time)
        told = ", ".join(f"{part} {describe(getattr(longest, part))}" for part in PARTS)
        return f"Its parts: {told}."

    def _components_said(self) -> str:
        longest = {each.value: self[each.value].maximum for each in Component if self[each.value].count}
        name = max(longest, key=lambda each: longest[each])
        return f"The component that took longest is {name}: up to {describe(longest[name])} at a time."


def times_of(result: Result) -> Mapping[str, Sequence[int]]:
    """Return all times (ns) that a result has, by name; the names are always the same."""
    reactions = [each for episode in result.episodes for each in episode.reactions.reactions]
    recorder = result.recorder
    return {
        "reaction": [reaction.time for reaction in reactions],
        **{part: [getattr(reaction, part) for reaction in reactions] for part in PARTS},
        "response": result.response_times,
        **{component.value: series.values() for component, series in recorder.components.items()},
        "slice": recorder.slices.values(),
        AGE: recorder.sample_age.values(),
    }


def learning_of(result: Result) -> Sequence[int]:
    """Return how long (ns) a transition took to learn, for each the mean of all.

    A slice is cut by the time that it takes, so that work that takes longer makes more slices, not longer ones. The
    longest hundredth of slices is left out, as it would decide the mean.
    """
    learning, slices = result.learning(), sorted(result.recorder.slices.values())
    learned = sum(count for how, count in learning.counts.items() if how != "shed")
    kept = slices[: ceil(SLICES_KEPT * len(slices))]
    whole = sum(kept) if kept else learning.share * result.recorder.elapsed
    return [round(whole / learned)] * learned


def ages_of(result: Result) -> Mapping[str, Sequence[int]]:
    """Return the ages (ns) at observation of the samples of each device, by "age of" its name."""
    names, series = list(result.device_counters), result.recorder.sample_age
    kept = series.values()  # of each observation the age of every device, in their order
    forgotten = series.count - len(kept)
    return {
        f"age of {name}": kept[(place - forgotten) % len(names) :: len(names)] for place, name in enumerate(names)
    }
