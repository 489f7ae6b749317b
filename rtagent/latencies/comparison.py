"""Comparisons: how many times as long, how sure, and a sentence for what is beyond a limit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from rtagent.errors import SpecError, UndecidedError, did_you_mean
from rtagent.experience import FloatArray
from rtagent.latencies.rounds import FLOOR, Measure, Rounds, Rules, floor, interleaved, of_subject, once
from rtagent.latencies.subject import Subject
from rtagent.latencies.times import needed
from rtagent.units import describe

RESAMPLED = 2000
SEED = 0


@dataclass(frozen=True)
class Ratio:
    """How many times as long as before something takes, with an interval; `before` and `after` are in ns."""

    name: str
    ratio: float
    low: float
    high: float
    before: float
    after: float

    def __str__(self) -> str:
        sure = f" ({self.low:.3g} to {self.high:.3g})" if self.high > self.low else ""
        return f"{self.name}: {self.ratio:.3g} ×{sure}, {describe(self.after)} against {describe(self.before)}"


@dataclass(frozen=True)
class Comparison:
    """The ratios of two runs, of one run to a floor; what had too few times to compare is in `too_few`."""

    before: str
    after: str
    ratios: Mapping[str, Ratio]
    too_few: Mapping[str, int]
    rounds: Rounds
    confidence: float
    exact: bool = False

    def __getitem__(self, name: str) -> Ratio:
        """Return a ratio; raises `UndecidedError` where too few times were measured, `SpecError` for no name."""
        if name in self.too_few:
            raise UndecidedError(
                f"a round of {self.after} or {self.before} has only {self.too_few[name]} times of {name}, "
                "which say too little: run more episodes in each."
            )
        if name not in self.ratios:
            raise SpecError(f"nothing was compared that is called {name!r}{did_you_mean(name, list(self.ratios))}")
        return self.ratios[name]

    def assert_at_most(self, limit: float, *names: str) -> None:
        """Fail where something surely takes more than `limit` times as long (by default anything).

        Surely: the whole interval lies above the limit. Raises `AssertionError` with a sentence on each, that first
        which grew most; `UndecidedError` where there are too few times, or an interval holds the limit while the
        ratio itself is above it.
        """
        __tracebackhide__ = True
        if not limit > 0:
            raise SpecError(f"the limit {limit} is no ratio: give how many times as long is allowed, such as 1.2.")
        ratios = [self[name] for name in names] or [self["reaction"], *self._others()]
        over = [ratio for ratio in ratios if ratio.low > limit]
        if over:
            raise AssertionError(self._said(over, limit))
        open_ones = [ratio for ratio in ratios if ratio.ratio > limit]
        if open_ones:
            raise UndecidedError(
                f"it is not sure that {self.after} keeps to {limit:g} × {self.before}: "
                f"{'; '.join(map(str, open_ones))}. {self._sure()} Measure more rounds."
            )

    def lines(self) -> list[str]:
        """Return what was measured, a line each."""
        told = [f"{self.after}, to {self.before}: {self._sure()}"]
        told += [f"  {ratio}" for ratio in self.ratios.values()]
        if self.too_few:
            told += [f"  too few to compare: {', '.join(f'{name} ({n})' for name, n in self.too_few.items())}"]
        return told

    def _others(self) -> Iterable[Ratio]:
        return (ratio for name, ratio in self.ratios.items() if name != "reaction")

    def _said(self, over: Sequence[Ratio], limit: float) -> str:
        first, *more = sorted(over, key=lambda ratio: (ratio.name in WHOLES, -(ratio.after - ratio.before)))
        told = [f"{self.after} is slower than {limit:g} × {self.before}, in {first.name} above all.", f"  {first}"]
        return "\n".join([*told, *(f"  {ratio}" for ratio in more), f"{self._sure()}"])

    def _sure(self) -> str:
        if self.exact:
            return "Exact: measured under the virtual clock."
        return f"Intervals of {self.confidence:.0%}, from {self.rounds.said()}"


WHOLES = ("reaction", "sensing", "deciding", "acting", "response", "sample age", FLOOR)
"""Times that components have their part in: told after the components themselves."""


def compare(before: Subject, after: Subject, rules: Rules, quantile: float = 0.5) -> Comparison:
    """Return how many times as long each thing takes in `after` as in `before`, by a quantile of each round."""
    if before.clock != after.clock:
        raise SpecError(
            f"{before.name} runs under the {before.clock} clock and {after.name} does not: use one clock."
        )
    if not 0 < quantile < 1:
        raise SpecError(f"the quantile {quantile} is not between 0 and 1: 0.5 is the median.")
    measures = [of_subject(before), of_subject(after)]
    exact = before.clock == "virtual"
    rounds = once(measures) if exact else interleaved(measures, rules)
    return _compared(before.name, after.name, rounds, rules, quantile, exact=exact)


def to_floor(subject: Subject, rules: Rules, quantile: float = 0.5) -> Comparison:
    """Return how many times a bare wake-up of this machine, on the same processor, each thing takes."""
    if subject.clock != "real":
        raise SpecError(f"{subject.name} runs under the virtual clock, which has no floor: compare it with a time.")
    measure = of_subject(subject)
    names = measure().keys()

    def wake_up() -> Mapping[str, Sequence[int]]:
        return dict.fromkeys(names, floor()[FLOOR])

    measures: list[Measure] = [wake_up, measure]
    return _compared("a bare wake-up", subject.name, interleaved(measures, rules), rules, quantile)


def _compared(
    before: str, after: str, rounds: Rounds, rules: Rules, quantile: float, *, exact: bool = False
) -> Comparison:
    least = 1 if exact else max(rules.least, needed(quantile))
    counts = {
        name: min(len(block[name]) for each in rounds.kept for block in each.blocks)
        for name in rounds.kept[0].blocks[0]
    }
    ratios = {
        name: _ratio(name, _quantiles(name, rounds, quantile), rules.confidence)
        for name, count in counts.items()
        if count >= least
    }
    # a component that never ran is nothing to speak of; reactions are what all is about
    too_few = {name: n for name, n in counts.items() if n < least and (n or name == "reaction")}
    return Comparison(before, after, ratios, too_few, rounds, rules.confidence, exact)


def _quantiles(name: str, rounds: Rounds, quantile: float) -> FloatArray:
    """Return the quantile (ns) of each block, shape (rounds, 2)."""
    return np.array([[np.quantile(block[name], quantile) for block in each.blocks] for each in rounds.kept])


def _ratio(name: str, quantiles: FloatArray, confidence: float) -> Ratio:
    """Return the geometric mean of the ratios of the rounds, with its interval by drawing rounds anew."""
    before, after = (float(each) for each in np.median(quantiles, axis=0))
    if not quantiles[:, 0].all() or not quantiles[:, 1].all():  # some costs nothing, as under the virtual clock
        ratio = 1.0 if before == after else inf if after > before else 0.0
        return Ratio(name, ratio, ratio, ratio, before, after)
    logs = np.log(quantiles[:, 1] / quantiles[:, 0])
    drawn = np.random.default_rng(SEED).integers(len(logs), size=(RESAMPLED, len(logs)))
    low, high = np.quantile(logs[drawn].mean(axis=1), ((1 - confidence) / 2, (1 + confidence) / 2))
    return Ratio(name, float(np.exp(logs.mean())), float(np.exp(low)), float(np.exp(high)), before, after)
