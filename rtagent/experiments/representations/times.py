"""What the thesis says of times (section 4.4, table 4.1), and what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rtagent.experiments.experiment import Claim, Table, Verdict
from rtagent.experiments.representations.points import Pair
from rtagent.experiments.statistics import Interval, above, all_of, below, compared, interval

THESIS = {
    ("tilings", 2): (247439, 302),
    ("tilings", 8): (244496, 534),
    ("tilings", 12): (245724, 620),
    ("prototypes", 2): (19333, 236),
    ("prototypes", 8): (12960, 198),
    ("prototypes", 12): (10883, 165),
}
"""Table 4.1: mean and standard deviation."""
CALLED = {"tilings": "tile coding", "prototypes": "selective Kanerva coding"}
PLAIN, KERNELS = "plain numpy", "kernels"
TOUCHED = "kernels touch what is active: tile coding's time is that of its tilings, however many tiles they have"
TIMES_LONGER = 1.1
"""From this ratio on a time is said to be longer: it is measured once for each representation."""


@dataclass(frozen=True)
class Timed:
    """How long (s) a step takes with one representation; `size` is its prototypes, 0 for tile coding."""

    dimensions: int
    size: int
    features: int
    step: float


def timed(pairs: Sequence[Pair], *, plain: bool) -> list[Timed]:
    """Return what was timed, in one form."""
    return [
        Timed(cell["dimensions"], cell.get("prototypes", 0), row["features"], row["step"])
        for cell, row in pairs
        if cell["plain"] is plain
    ]


def time_claims(pairs: Sequence[Pair]) -> Iterator[Claim]:
    """Yield claims about the time of a step, of the plain numpy forms and of the compiled ones."""
    for plain, form in ((True, PLAIN), (False, KERNELS)):
        found = timed(pairs, plain=plain)
        yield from _claims([each for each in found if each.size], [each for each in found if not each.size], form)


def _claims(kanerva: Sequence[Timed], tiles: Sequence[Timed], form: str) -> Iterator[Claim]:
    yield _longer(kanerva, form, CALLED["prototypes"])
    yield _longer(tiles, form, CALLED["tilings"])
    largest = max(each.size for each in kanerva)
    steps = {each.dimensions: each.step for each in kanerva if each.size == largest}
    yield _trend(
        f"a step of selective Kanerva coding takes longer with more dimensions ({form})",
        "the computation time increased with additional dimensions",
        [steps[8] / steps[2], steps[12] / steps[8]],
        f"{largest:,} prototypes: "
        + ", ".join(f"{number} dimensions {_us(step)}" for number, step in steps.items()),
    )
    yield _cheaper(kanerva, tiles, form)


def _longer(found: Sequence[Timed], form: str, called: str) -> Claim:
    ratios, told = [], []
    for dimensions in sorted({each.dimensions for each in found}):
        line = sorted((each for each in found if each.dimensions == dimensions), key=lambda each: each.features)
        ratios.append(line[-1].step / line[0].step)
        told.append(
            f"{dimensions} dimensions: {line[0].features:,} features {_us(line[0].step)}, "
            f"{line[-1].features:,} {_us(line[-1].step)}"
        )
    said = f"a step of {called} takes longer with more features ({form})"
    theirs = "the timestep duration increased as the number of features increased"
    return _trend(
        said, theirs, ratios, "; ".join(told), TOUCHED if (form, called) == (KERNELS, CALLED["tilings"]) else ""
    )


def _cheaper(kanerva: Sequence[Timed], tiles: Sequence[Timed], form: str) -> Claim:
    """Return: at about the same number of features, tile coding takes less time."""
    ratios = []
    for each in kanerva:
        near = min(
            (other for other in tiles if other.dimensions == each.dimensions),
            key=lambda other: abs(np.log(other.features / each.features)),
        )
        ratios.append(each.step / near.step)
    ratio = interval(ratios, np.median)
    return Claim(
        f"tile coding takes less time than selective Kanerva coding with about as many features ({form})",
        "tile coding was significantly more time efficient",
        f"selective Kanerva coding takes {ratio} times as long, in the median over sizes",
        above(ratio, 1.0),
    )


def _trend(said: str, theirs: str, ratios: Sequence[float], told: str, because: str = "") -> Claim:
    verdict = all_of(above(Interval(each, each, each), TIMES_LONGER) for each in ratios)
    return Claim(said, theirs, told, verdict, because)


def _us(seconds: float) -> str:
    return f"{seconds * 1e6:.3g} µs"


def table_claims(pairs: Sequence[Pair]) -> Iterator[Claim]:
    """Yield what is said of table 4.1."""
    found = {
        key: [row["features"] for cell, row in pairs if (cell["what"], cell["dimensions"]) == key] for key in THESIS
    }
    told = {key: interval(values) for key, values in found.items()}
    same = [mean - 2 * spread <= told[key].high and told[key].low <= mean + 2 * spread
            for key, (mean, spread) in THESIS.items()]  # fmt: skip
    yield Claim(
        "so many features are computed within 100 ms as table 4.1 has",
        ", ".join(f"{_named(key)} {mean:,}" for key, (mean, _) in THESIS.items()),
        ", ".join(f"{_named(key)} {each}" for key, each in told.items()),
        Verdict.REPRODUCED if all(same) else Verdict.DIFFERS,
        "another processor, and compiled kernels; what we count of tile coding are tilings, each computed, "
        "where the thesis counts all tiles",
    )
    fewer = [
        compared(found["prototypes", more], found["prototypes", less], _ratio) for more, less in ((8, 2), (12, 8))
    ]
    yield Claim(
        "the more dimensions, the fewer prototypes fit into 100 ms",
        "19,333, 12,960 and 10,883 prototypes with 2, 8 and 12 dimensions",
        f"8 to 2 dimensions: ratio {fewer[0]}; 12 to 8: {fewer[1]}",
        all_of(below(each, 1.0) for each in fewer),
    )


def _ratio(ours: float, others: float) -> float:
    return ours / others


def _named(key: tuple[str, int]) -> str:
    return f"{CALLED[key[0]]} with {key[1]}"


def table(pairs: Sequence[Pair]) -> Table:
    """Return table 4.1 with ours beside it."""
    rows = []
    for (what, dimensions), (mean, spread) in THESIS.items():
        some = [row for cell, row in pairs if (cell["what"], cell["dimensions"]) == (what, dimensions)]
        rows.append((CALLED[what], str(dimensions), _mean(some), f"{mean:,} ± {spread}"))
    seeds = len({cell["seed"] for cell, _ in pairs})
    caption = (
        f"Table 4.1: features that are computed within 100 ms, mean ± standard deviation over {seeds} seeds; ≥ "
        "where a quarter of the free memory was full before. States are independent of each other."
    )
    return Table(caption, ("representation", "dimensions", "ours", "thesis (a core of 2.5 GHz)"), tuple(rows))


def _mean(rows: Sequence[Any]) -> str:
    features = [row["features"] for row in rows]
    least = "≥ " if any(row["bounded"] for row in rows) else ""
    return f"{least}{np.mean(features):,.0f} ± {np.std(features, ddof=1):,.0f}"
