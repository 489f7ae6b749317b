"""What the thesis says of errors (section 4.4), and what the data say of it.

Intervals are over the streams, which have in common what happens in them: each ratio is that of one stream.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rtagent.experiments.experiment import Claim, Verdict
from rtagent.experiments.representations.points import Point
from rtagent.experiments.representations.within import TIME
from rtagent.experiments.statistics import Interval, above, all_of, below, interval

BEST = 8000
"""Prototypes, that the thesis found best."""
LITTLE = 0.05
PRINTED, EQUAL = "printed", "equal"
"""Readings of the step size: as it is printed, and the same pace for all."""


def error_claims(points: Sequence[Point], reading: str, told: str) -> list[Claim]:
    """Return all claims about errors under one reading of the step size; `told` says of what stream and reading."""
    found = _Found(points, reading, told)
    several = (*found.against_tiles(), *found.with_as_many_features(), *found.more_dimensions())
    return [*several, found.best_of_all(), found.convex(), found.seeds()]


class _Found:
    """The points, and how they compare."""

    def __init__(self, points: Sequence[Point], reading: str, told: str) -> None:
        self._reading, self._told = reading, told
        self._kanerva = {(point.dimensions, point.size): point for point in points if point.size}
        self._dimensions = sorted({dimensions for dimensions, _ in self._kanerva})
        sizes = [size for _, size in self._kanerva]
        self._smallest, self._largest = min(sizes), max(sizes)
        self._in_time = [point for point in points if not point.size and point.step <= TIME]
        self._tiles = {dimensions: self._best_tiles(dimensions) for dimensions in self._dimensions}

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
                below(ratio, 1.0),
                self._at_one_pace(ours) if self._reading == PRINTED else "",
            )

    def _best_tiles(self, dimensions: int) -> Point:
        return min((each for each in self._in_time if each.dimensions == dimensions), key=self._mean)

    def _at_one_pace(self, ours: Point) -> str:
        """Say how the two compare where all representations learn at the same pace."""
        best = self._tiles[ours.dimensions]
        found = _ratio(ours, best, EQUAL)
        return f"at the same pace, the two err by {ours.mean(EQUAL):.3g} and {best.mean(EQUAL):.3g}, ratio {found}"

    def with_as_many_features(self) -> Iterator[Claim]:
        """Yield: selective Kanerva coding errs less than tile coding that has no more features."""
        for dimensions in (8, 12):
            ours = self._kanerva[dimensions, BEST]
            few = [each for each in self._in_time if each.dimensions == dimensions and each.features <= BEST]
            best = min(few, key=self._mean)
            ratio = self._ratio(ours, best)
            yield Claim(
                f"{dimensions} dimensions: {BEST:,} prototypes err less than tile coding with no more features "
                f"({self._told})",
                "improved prediction accuracy while reducing the number of features necessary (chapter 7)",
                f"{self._told_of(ours)}; the best of {len(few)} tile codings ({best.called}, {best.features:,} "
                f"features) {self._told_of(best)}; ratio {ratio}",
                below(ratio, 1.0),
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
                below(ratio, 1.0),
            )
        for more in (8, 12):
            ratio = self._ratio(self._tiles[more], self._tiles[2])
            yield Claim(
                f"tile coding errs no less with {more} dimensions than with 2 ({self._told})",
                "8 and 12 dimensions did not improve the error beyond what 2 achieved within 100 ms",
                f"{self._told_of(self._tiles[more])} to {self._told_of(self._tiles[2])}; ratio {ratio}",
                above(ratio, 1.0),
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
            below(ratio, 1.0),
        )

    def convex(self) -> Claim:
        """Return: the error falls to a minimum at 8,000 prototypes and rises again."""
        ends = {dimensions: self._ends(dimensions, self._reading) for dimensions in self._dimensions}
        told = [
            f"{dimensions} dimensions: least at {self._least(dimensions):,}; {self._smallest:,} to {BEST:,} {few}, "
            f"{self._largest:,} to {BEST:,} {many}"
            for dimensions, (few, many) in ends.items()
        ]
        return Claim(
            f"more prototypes than {BEST:,} err more, and so do fewer ({self._told})",
            "the error has a convex form with a minimum at 8000",
            "; ".join(told),
            all_of(above(each, 1.0) for both in ends.values() for each in both),
            self._pace() if self._reading == PRINTED else "",
        )

    def _pace(self) -> str:
        """Say what becomes of the form where all numbers of prototypes learn at the same pace."""
        ends = [(dimensions, self._ends(dimensions, EQUAL)[1]) for dimensions in self._dimensions]
        return (
            "with the same α for each weight, more active features move a prediction further at each step; where "
            f"all move it as far as {BEST:,} prototypes do, {self._largest:,} to {BEST:,} are "
            + ", ".join(f"{ratio} ({dimensions} dimensions)" for dimensions, ratio in ends)
        )

    def _ends(self, dimensions: int, reading: str) -> tuple[Interval, Interval]:
        """Return how the fewest and how the most prototypes err, as ratios to the 8,000."""
        best = self._kanerva[dimensions, BEST]
        few, many = (self._kanerva[dimensions, size] for size in (self._smallest, self._largest))
        return _ratio(few, best, reading), _ratio(many, best, reading)

    def _least(self, dimensions: int) -> int:
        own = [point for (number, _), point in self._kanerva.items() if number == dimensions]
        return min(own, key=self._mean).size

    def seeds(self) -> Claim:
        """Return: how prototypes are drawn matters little."""
        spreads = [self._spread(point) for (_, size), point in self._kanerva.items() if size == BEST]
        spread = interval(np.concatenate(spreads))
        return Claim(
            f"how prototypes are drawn changes errors by less than {LITTLE:.0%} ({self._told})",
            "consistently small standard error across distributions of prototypes",
            f"standard deviation over seeds, as a part of the mean, {spread}",
            below(spread, LITTLE),
        )

    def _spread(self, point: Point) -> np.ndarray:
        errors = point.errors[self._reading]
        spread: np.ndarray = errors.std(axis=1, ddof=1) / errors.mean(axis=1)
        return spread

    def _mean(self, point: Point) -> float:
        return point.mean(self._reading)

    def _ratio(self, ours: Point, others: Point) -> Interval:
        return _ratio(ours, others, self._reading)

    def _told_of(self, point: Point) -> str:
        errors = point.each_stream(self._reading)
        return f"{interval(errors)}" if np.isfinite(errors).all() else "no error, as it diverged"


def _ratio(ours: Point, others: Point, reading: str) -> Interval:
    return interval(ours.each_stream(reading) / others.each_stream(reading))


def reproduced(claims: Sequence[Claim]) -> int:
    """Return how many of the claims came out."""
    return sum(claim.verdict is Verdict.REPRODUCED for claim in claims)
