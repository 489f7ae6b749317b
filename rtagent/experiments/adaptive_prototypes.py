"""Prototypes that move to where states are, against as many that stay (thesis, section 6.3.2, a proposal)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rtagent.clock import RealClock
from rtagent.experiments import beyond
from rtagent.experiments.beyond import STREAMS, UNITS, Problem, problem
from rtagent.experiments.chunks import follow_chunks
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Table, Verdict
from rtagent.experiments.statistics import Interval, above, all_of, below, compared, interval
from rtagent.experiments.streams import part_error
from rtagent.experiments.style import series
from rtagent.features import AdaptiveKanerva, SelectiveKanerva
from rtagent.learning import TrueOnlineTD

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

FIXED, ADAPTIVE, FARTHER = "staying", "moving", "moving, farther apart"
SPACINGS = {ADAPTIVE: 0.01, FARTHER: 0.05}
"""How close to another one a prototype may come: about the noise of a signal; and as it was tried first."""
SIZES, QUICK_SIZES = (250, 500, 1000, 2000, 4000, 8000), (250, 1000, 4000)
SEEDS, QUICK_SEEDS = 10, 5
FIRST_PART = 0.5
"""All prototypes can have moved within this part of what is learned before the test."""


def cells(options: Options) -> list[Cell]:
    """Return a cell for each stream, number of prototypes, and seed of these."""
    sizes, seeds = (QUICK_SIZES, QUICK_SEEDS) if options.quick else (SIZES, SEEDS)
    return beyond.cells(sizes, seeds, options)


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return float(0.5 + beyond.rows_of(cell) * (20e-6 + 6e-9 * cell["prototypes"]))


def measure(cell: Cell) -> Row:
    """Return the errors, and times of a step, of prototypes that stay and that move, from the same on."""
    given = problem(cell["stream"], cell["every"])
    made: dict[str, Any] = {
        "state": given.state,
        "prototypes": cell["prototypes"],
        "eta": cell["eta"],
        "seed": cell["seed"],
    }
    between = max(1, int(FIRST_PART * given.tested / cell["prototypes"]))
    row: dict[str, Any] = {FIXED: _predicted(given, SelectiveKanerva(**made))}
    for kind, spacing in SPACINGS.items():
        coder = AdaptiveKanerva(**made, interval=between, spacing=spacing)
        began = coder.prototypes.copy()
        row[kind] = _predicted(given, coder)
        row[kind]["moved"] = float(np.any(coder.prototypes != began, axis=1).mean())
    return row | {"told": given.told}


def _predicted(given: Problem, coder: SelectiveKanerva | AdaptiveKanerva) -> dict[str, float | None]:
    learner = TrueOnlineTD(
        size=coder.size, active=coder.active, alpha=given.alpha, gamma=given.gamma, lambda_=given.lambda_
    )
    start = RealClock.now()
    found = follow_chunks(given.states, coder, {"it": learner}, {"it": given.cumulants}, given.until)["it"]
    step = (RealClock.now() - start) / 1e9 / len(given.states)
    error = part_error(found, given.truth, slice(given.tested, None))
    return {"error": None if np.isnan(error) else error, "step": step}


Group = tuple[str, int]
"""A stream and a number of prototypes."""


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Return whether prototypes that move err less, depend less on where they began, and take more time."""
    groups: dict[Group, list[Row]] = {}
    for cell, row in pairs:
        groups.setdefault((cell["stream"], cell["prototypes"]), []).append(row)
    if any(each[kind]["error"] is None for rows in groups.values() for each in rows for kind in (FIXED, *SPACINGS)):
        return Findings((Claim("Learning converges", "it does", "it diverged", Verdict.NOT_REPRODUCED),))
    claims = [claim for stream in STREAMS for claim in _claims(stream, groups)]
    return Findings(tuple(claims), (_figure(groups, pairs),), (_table(groups),))


def _claims(stream: str, groups: Mapping[Group, Sequence[Row]]) -> list[Claim]:
    sizes = {size: rows for (name, size), rows in groups.items() if name == stream}
    proposed = "(6.3.2, a proposal that was not tried)"
    return [
        _claim(
            f"On the {stream} stream prototypes that move err less than as many that stay",
            f"finer granularity over important areas {proposed}",
            {size: ratio(rows, "error") for size, rows in sizes.items()},
            "times the error",
            below,
        ),
        _claim(
            f"On the {stream} stream they depend less on where prototypes were drawn",
            f"should minimize the sensitivity to prototype distributions {proposed}",
            {size: spread(rows) for size, rows in sizes.items()},
            "times the standard deviation over seeds",
            below,
        ),
        _claim(
            f"On the {stream} stream they take more time",
            f"at the cost of more computation time {proposed}",
            {size: ratio(rows, "step") for size, rows in sizes.items()},
            "times the time of a step",
            above,
        ),
    ]


def _claim(said: str, theirs: str, found: Mapping[int, Interval], unit: str, side: Any) -> Claim:
    """Return a claim about every size; where it holds for some only, it is told for which it does not."""
    verdicts = {size: side(each, 1.0) for size, each in found.items()}
    ours = "; ".join(f"{size:,} prototypes: {each} {unit}" for size, each in found.items())
    other = [f"{size:,} ({each})" for size, each in verdicts.items() if each != Verdict.REPRODUCED]
    because = f"not so for {', '.join(other)}" if 0 < len(other) < len(found) else ""
    return Claim(said, theirs, ours, all_of(verdicts.values()), because)


def ratio(rows: Sequence[Row], name: str) -> Interval:
    """Return how many times a number is of prototypes that move what it is of those that stay, seed by seed."""
    return interval([row[ADAPTIVE][name] / row[FIXED][name] for row in rows])


def spread(rows: Sequence[Row]) -> Interval:
    """Return how many times the standard deviation of errors over seeds is that of prototypes that stay."""
    moving, staying = ([row[kind]["error"] for row in rows] for kind in (ADAPTIVE, FIXED))
    return compared(moving, staying, lambda ours, others: ours / max(others, 1e-12), np.std)


def _table(groups: Mapping[Group, Sequence[Row]]) -> Table:
    head = ("stream", "prototypes", "which are", "mean absolute error", "have moved", "µs a step")
    rows = tuple(
        (stream, f"{size:,}", kind, *_numbers([row[kind] for row in several]))
        for (stream, size), several in groups.items()
        for kind in (FIXED, *SPACINGS)
    )
    apart = ", ".join(f"{kind}: {spacing}" for kind, spacing in SPACINGS.items())
    return Table(
        f"Errors of the test, with intervals over seeds of prototypes (least distance: {apart}).", head, rows
    )


def _numbers(several: Sequence[Mapping[str, Any]]) -> tuple[str, str, str]:
    moved = [100.0 * each.get("moved", 0.0) for each in several]
    steps = [1e6 * each["step"] for each in several]
    return str(interval([each["error"] for each in several])), f"{np.mean(moved):.0f} %", f"{np.median(steps):.1f}"


def _figure(groups: Mapping[Group, Sequence[Row]], pairs: Sequence[tuple[Cell, Row]]) -> Figure:
    told = {cell["stream"]: row["told"] for cell, row in pairs}
    seeds = len({cell["seed"] for cell, _ in pairs})
    caption = (
        f"Mean absolute errors with prototypes that stay and that move, η {pairs[0][0]['eta']}, {seeds} seeds of "
        f"prototypes with their intervals; {'; '.join(told.values())}."
    )
    return Figure("errors", caption, partial(_draw, groups=groups), (7.5, 3.5))


def _draw(canvas: Canvas, groups: Mapping[Group, Sequence[Row]]) -> None:
    for axes, stream in zip(canvas.subplots(1, len(STREAMS)), STREAMS, strict=True):
        sizes = sorted(size for name, size in groups if name == stream)
        for number, kind in enumerate((FIXED, *SPACINGS)):
            found = [interval([row[kind]["error"] for row in groups[stream, size]]) for size in sizes]
            low, middle, high = ([getattr(each, end) for each in found] for end in ("low", "middle", "high"))
            series(axes, number, sizes, middle, kind, low=low, high=high)
        axes.set_xscale("log")
        axes.set_title(stream)
        axes.set_xlabel("prototypes")
        axes.set_ylabel(f"mean absolute error ({UNITS[stream]})")
        axes.legend()


EXPERIMENT = Experiment(
    name="adaptive-prototypes",
    title="Prototypes that move to where states are",
    thesis="Section 6.3.2, a proposal; on the streams of chapters 4 and 5",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(
        beyond.MODELLED,
        "When prototypes move is after Ratitch and Precup (2004), not theirs in all: here as many as ever are "
        "active, and the least visited one goes.",
    ),
)
