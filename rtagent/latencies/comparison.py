"""Comparisons: how many times as long, how sure, and a sentence for what is beyond a limit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import inf

import numpy as np

from rtagent.errors import SpecError, UndecidedError, did_you_mean
from rtagent.experience import FloatArray
from rtagent.latencies.rounds import (
    FLOOR,
    LEARNING,
    Block,
    Measure,
    Rounds,
    Rules,
    floor,
    interleaved,
    of_subject,
    once,
)
from rtagent.latencies.subject import Subject
from rtagent.latencies.times import needed
from rtagent.units import describe

RESAMPLED = 2000
TRIMMED = 5
SEED = 0
EXACT = "Exact: measured under the virtual clock."


class Verdict(StrEnum):
    """What an interval says of a limit."""

    SLOWER = "slower"
    UNSURE = "not sure"
    KEPT = ""
    QUICKER = "quicker"


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
        return f"{self.name}: {self.said()}, {describe(self.after)} against {describe(self.before)}"

    def said(self) -> str:
        """Return the ratio with its interval."""
        sure = f" ({self.low:.3g} to {self.high:.3g})" if self.high > self.low else ""
        return f"{self.ratio:.3g} ×{sure}"

    def verdict(self, limit: float) -> Verdict:
        """Say whether it takes at most `limit` times as long: surely not where the whole interval is above."""
        if self.low > limit:
            return Verdict.SLOWER
        if self.ratio > limit:
            return Verdict.UNSURE
        return Verdict.QUICKER if self.high < 1 / limit else Verdict.KEPT


@dataclass(frozen=True)
class Comparison:
    """The ratios of two runs, or of one run to a floor.

    What had too few times to compare is in `too_few`; `sure` is a sentence on the intervals.
    """

    before: str
    after: str
    ratios: Mapping[str, Ratio]
    too_few: Mapping[str, int]
    sure: str

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
        over = [ratio for ratio in ratios if ratio.verdict(limit) is Verdict.SLOWER]
        if over:
            raise AssertionError(self._said(over, limit))
        open_ones = [ratio for ratio in ratios if ratio.verdict(limit) is Verdict.UNSURE]
        if open_ones:
            raise UndecidedError(
                f"it is not sure that {self.after} keeps to {limit:g} × {self.before}: "
                f"{'; '.join(map(str, open_ones))}. {self.sure} Measure more rounds."
            )

    def lines(self) -> list[str]:
        """Return what was measured, a line each."""
        told = [f"{self.after}, to {self.before}: {self.sure}"]
        told += [f"  {ratio}" for ratio in self.ratios.values()]
        if few := self.worth_telling():
            told += [f"  too few to compare: {', '.join(f'{name} ({n})' for name, n in few.items())}"]
        return told

    def worth_telling(self) -> dict[str, int]:
        """Return what had too few times, but for what never ran: reactions are what all is about."""
        return {name: count for name, count in self.too_few.items() if count or name == "reaction"}

    def _others(self) -> Iterable[Ratio]:
        return (ratio for name, ratio in self.ratios.items() if name != "reaction")

    def _said(self, over: Sequence[Ratio], limit: float) -> str:
        first, *more = sorted(over, key=lambda ratio: (ratio.name in WHOLES, -(ratio.after - ratio.before)))
        told = [f"{self.after} is slower than {limit:g} × {self.before}, in {first.name} above all.", f"  {first}"]
        return "\n".join([*told, *(f"  {ratio}" for ratio in more), f"{self.sure}"])


WHOLES = ("reaction", "sensing", "deciding", "acting", "response", "sample age", LEARNING, FLOOR)
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
    return compared(before.name, after.name, rounds, rules, quantile, exact=exact)


def to_floor(subject: Subject, rules: Rules, quantile: float = 0.5) -> Comparison:
    """Return how many times a bare wake-up of this machine, on the same processor, each thing takes."""
    if subject.clock != "real":
        raise SpecError(f"{subject.name} runs under the virtual clock, which has no floor: compare it with a time.")
    measure = of_subject(subject)
    names = measure.run().keys()

    def wake_up() -> Block:
        return dict.fromkeys(names, floor()[FLOOR])

    rounds = interleaved([Measure(wake_up), measure], rules)
    return compared("a bare wake-up", subject.name, rounds, rules, quantile)


def compared(
    before: str, after: str, rounds: Rounds, rules: Rules, quantile: float = 0.5, *, exact: bool = False
) -> Comparison:
    """Return the ratios of the second measure of each round to the first."""
    sides = [Quantiles.of([each.blocks[side] for each in rounds.kept], quantile) for side in range(2)]
    least = 1 if exact else max(rules.least, needed(quantile))
    sure = EXACT if exact else f"Intervals of {rules.confidence:.0%}, from {rounds.said()}"
    return _comparison((before, after), sides, least, rules.confidence, sure, paired=True)


def to_stored(before: str, after: str, stored: Quantiles, now: Quantiles, rules: Rules) -> Comparison:
    """Return the ratios of medians measured now to those stored: rounds of two sessions, which are no pairs."""
    sure = (
        f"Intervals of {rules.confidence:.0%}, from {now.rounds} rounds and {stored.rounds} stored ones, "
        "measured at another time."
    )
    return _comparison((before, after), (stored, now), rules.least, rules.confidence, sure, paired=False)


@dataclass(frozen=True)
class Quantiles:
    """A quantile (ns) of each name in each round, and how many times of it the poorest round had."""

    values: Mapping[str, Sequence[float]]
    counts: Mapping[str, int]

    @classmethod
    def of(cls, blocks: Sequence[Block], quantile: float = 0.5) -> Quantiles:
        """Return those of blocks, one of each round; a name that a round has no times of has no values."""
        counts = {name: min(len(block[name]) for block in blocks) for name in blocks[0]}
        values = {
            name: [float(np.quantile(block[name], quantile)) for block in blocks]
            for name, count in counts.items()
            if count
        }
        return cls(values, counts)

    def joined(self, other: Quantiles) -> Quantiles:
        """Return both: of the same rounds, under other names."""
        return Quantiles({**self.values, **other.values}, {**self.counts, **other.counts})

    @property
    def rounds(self) -> int:
        """How many rounds there are."""
        return max(map(len, self.values.values()), default=0)


def _comparison(
    names: tuple[str, str], sides: Sequence[Quantiles], least: int, confidence: float, sure: str, *, paired: bool
) -> Comparison:
    before, after = sides
    counts = {name: min(count, after.counts.get(name, 0)) for name, count in before.counts.items()}
    ratios = {
        name: _ratio(name, before.values[name], after.values[name], confidence, paired=paired)
        for name, count in counts.items()
        if count >= least
    }
    too_few = {name: count for name, count in counts.items() if count < least}
    return Comparison(*names, ratios, too_few, sure)


def _ratio(name: str, before: Sequence[float], after: Sequence[float], confidence: float, *, paired: bool) -> Ratio:
    """Return the ratio of trimmed geometric means, with its interval by drawing rounds (pairs of them) anew."""
    middles = float(np.median(before)), float(np.median(after))
    if not (all(before) and all(after)):  # some costs nothing, as under the virtual clock
        ratio = 1.0 if middles[0] == middles[1] else inf if middles[1] > middles[0] else 0.0
        return Ratio(name, ratio, ratio, ratio, *middles)
    logs = [np.log(before), np.log(after)]
    drawn = _drawn(logs[1] - logs[0]) if paired else _drawn(logs[1]) - _drawn(logs[0], SEED + 1)
    low, high = np.quantile(drawn, ((1 - confidence) / 2, (1 + confidence) / 2))
    middle = _trimmed(logs[1] - logs[0]) if paired else _trimmed(logs[1]) - _trimmed(logs[0])
    return Ratio(name, float(np.exp(middle)), float(np.exp(low)), float(np.exp(high)), *middles)


def _drawn(values: FloatArray, seed: int = SEED) -> FloatArray:
    """Return the trimmed means of samples of these values, shape (RESAMPLED,)."""
    places = np.random.default_rng(seed).integers(len(values), size=(RESAMPLED, len(values)))
    return _trimmed(values[places])


def _trimmed(values: FloatArray) -> FloatArray:
    """Return the mean over the last axis without the fifth at either end: a round that was disturbed is there."""
    count = values.shape[-1]
    means: FloatArray = np.sort(values, axis=-1)[..., count // TRIMMED : count - count // TRIMMED].mean(axis=-1)
    return means
