"""What the thesis says of errors (section 4.4), and what the data say of it.

Intervals are over the streams, which have in common what happens in them: each ratio is that of one stream.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rtagent.experiments.experiment import Claim, Verdict
from rtagent.experiments.representations.points import Point
from rtagent.experiments.representations.within import TIME
from rtagent.experiments.statistics import Interval, all_of, interval, within

BEST = 8000
"""Prototypes, that the thesis found best."""
LITTLE = 0.05


def error_claims(points: Sequence[Point], reading: str, told: str) -> list[Claim]:
    """Return all claims about errors under one reading of the step size; `told` says of what stream and reading."""
    found = _Found(points, reading, told)
    return [*found.against_tiles(), *found.more_dimensions(), found.best_of_all(), found.convex(), found.seeds()]


class _Found:
    """The points, and how they compare."""

    def __init__(self, points: Sequence[Point], reading: str, told: str) -> None:
        self._reading, self._told = reading, told
        self._kanerva = {(point.dimensions, point.size): point for point in points if point.size}
        in_time = [point for point in points if not point.size and point.step <= TIME]
        self._tiles = {
            dimensions: min((each for each in in_time if each.dimensions == dimensions), key=self._mean)
            for dimensions in sorted({point.dimensions for point in in_time})
        }

    def against_tiles(self) -> Iterator[Claim]:
        """Yield: selective Kanerva coding errs less than any tile coding within the time."""
        for dimensions in (8, 12):
            ours, best = self._kanerva[dimensions, BEST], self._tiles[dimensions]
            ratio = self._ratio(ours, best)
            yield Claim(
                f"{dimensions} dimensions: {BEST:,} prototypes err less than tile coding of any memory within "
                f"{TIME * 1e3:.0f} ms a step ({self._told})",
                "the best performance of all was that of selective Kanerva coding (figure 4.4)",
                f"{self._told_of(ours)}; the best tile coding ({best.called}, {best.features:,} features) "
                f"{self._told_of(best)}; ratio {ratio}",
                within(ratio, high=1.0),
            )

    def more_dimensions(self) -> Iterator[Claim]:
        """Yield: added dimensions help selective Kanerva coding, and do not help tile coding."""
        for more, fewer in ((8, 2), (12, 8)):
            ratio = self._ratio(self._kanerva[more, BEST], self._kanerva[fewer, BEST])
            yield Claim(
                f"{BEST:,} prototypes err less with {more} dimensions than with {fewer} ({self._told})",
                "it utilized the additional dimensions to improve performance with the same number of prototypes",
                f"{self._told_of(self._kanerva[more, BEST])} to {self._told_of(self._kanerva[fewer, BEST])}; "
                f"ratio {ratio}",
                within(ratio, high=1.0),
            )
        for more in (8, 12):
            ratio = self._ratio(self._tiles[more], self._tiles[2])
            yield Claim(
                f"tile coding errs no less with {more} dimensions than with 2 ({self._told})",
                "8 and 12 dimensions did not improve the error beyond what 2 achieved within 100 ms",
                f"{self._told_of(self._tiles[more])} to {self._told_of(self._tiles[2])}; ratio {ratio}",
                within(ratio, low=1.0),
            )

    def best_of_all(self) -> Claim:
        """Return: 12 dimensions and 8,000 prototypes are the best of all."""
        ours = self._kanerva[12, BEST]
        others = [point for point in (*self._kanerva.values(), *self._tiles.values()) if point is not ours]
        best = min(others, key=self._mean)
        ratio = self._ratio(ours, best)
        return Claim(
            f"12 dimensions with {BEST:,} prototypes are the best of all ({self._told})",
            "12 dimensions with 8000 features demonstrated the overall best performance",
            f"{self._told_of(ours)}; the best other ({best.dimensions} dimensions, {best.called}) "
            f"{self._told_of(best)}; ratio {ratio}",
            within(ratio, high=1.0),
        )

    def convex(self) -> Claim:
        """Return: the error falls to a minimum at 8,000 prototypes and rises again."""
        verdicts, told = [], []
        for dimensions in sorted({dimensions for dimensions, _ in self._kanerva}):
            line = sorted(size for known, size in self._kanerva if known == dimensions)
            least = min(line, key=lambda size: self._mean(self._kanerva[dimensions, size]))
            ends = [self._ratio(self._kanerva[dimensions, end], self._kanerva[dimensions, BEST])
                    for end in (line[0], line[-1])]  # fmt: skip
            verdicts += [within(each, low=1.0) for each in ends]
            told.append(
                f"{dimensions} dimensions: least at {least:,}; {line[0]:,} to {BEST:,} {ends[0]}, "
                f"{line[-1]:,} to {BEST:,} {ends[1]}"
            )
        return Claim(
            f"more prototypes than {BEST:,} err more, and so do fewer ({self._told})",
            "the error has a convex form with a minimum at 8000",
            "; ".join(told),
            all_of(verdicts),
        )

    def seeds(self) -> Claim:
        """Return: how prototypes are drawn matters little."""
        spreads = [self._spread(point) for (_, size), point in self._kanerva.items() if size == BEST]
        spread = interval(np.concatenate(spreads))
        return Claim(
            f"how prototypes are drawn changes errors by less than {LITTLE:.0%} ({self._told})",
            "consistently small standard error across distributions of prototypes",
            f"standard deviation over seeds, as a part of the mean, {spread}",
            within(spread, high=LITTLE),
        )

    def _spread(self, point: Point) -> np.ndarray:
        errors = point.errors[self._reading]
        spread: np.ndarray = errors.std(axis=1, ddof=1) / errors.mean(axis=1)
        return spread

    def _mean(self, point: Point) -> float:
        return point.mean(self._reading)

    def _ratio(self, ours: Point, others: Point) -> Interval:
        return interval(ours.each_stream(self._reading) / others.each_stream(self._reading))

    def _told_of(self, point: Point) -> str:
        return f"{interval(point.each_stream(self._reading))}"


def reproduced(claims: Sequence[Claim]) -> int:
    """Return how many of the claims came out."""
    return sum(claim.verdict is Verdict.REPRODUCED for claim in claims)
