"""What is found in all that was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rtagent.experiments.experiment import Claim, Findings, Options, Table
from rtagent.experiments.representations.cells import ALPHA, READINGS, RECORDING
from rtagent.experiments.representations.claims import error_claims, reproduced
from rtagent.experiments.representations.configurations import DIMENSIONS
from rtagent.experiments.representations.figures import error_figure, time_figure
from rtagent.experiments.representations.points import Pair, Point, points
from rtagent.experiments.representations.signals import BENTO, LAYOUTS, Layout
from rtagent.experiments.representations.times import table, table_claims, time_claims, timed

CALLED = {
    "printed": f"α = {ALPHA:g} of each weight",
    "divided": f"α = {ALPHA:g} / c",
    "equal": f"α = {READINGS['equal'][0]:g} / c",
}

FIGURES = ("printed", "equal")
BASELINES = ("mean", "as it is", "constant")


def find(pairs: Sequence[Pair], options: Options) -> Findings:
    """Return what was found: errors on the simulated arm and on a recording, times, and table 4.1."""
    errors = _of_kind(pairs, "error", "baseline")
    sources = dict.fromkeys(cell["source"] for cell, _ in errors)
    found = [_of_source([pair for pair in errors if pair[0]["source"] == source], source) for source in sources]
    times, fitting = _of_kind(pairs, "time"), _of_kind(pairs, "within")
    found.append(
        Findings(
            (*time_claims(times), *table_claims(fitting)),
            (time_figure(timed(times, plain=True), timed(times, plain=False)),),
            (table(fitting),),
            () if RECORDING in sources else ("No recording was given: --data FILE does the same on one.",),
        )
    )
    return together(found)


def together(found: Sequence[Findings]) -> Findings:
    """Return all that was found, in its order."""
    return Findings(
        tuple(claim for each in found for claim in each.claims),
        tuple(figure for each in found for figure in each.figures),
        tuple(table for each in found for table in each.tables),
        tuple(note for each in found for note in each.notes),
    )


def _of_kind(pairs: Sequence[Pair], *kinds: str) -> list[Pair]:
    return [(cell, row) for cell, row in pairs if cell["kind"] in kinds]


def _of_source(pairs: Sequence[Pair], source: str) -> Findings:
    """Return what was found on one arm, or on a recording: claims with the step size as it is printed."""
    layout, found = _layout(pairs), points(_of_kind(pairs, "error"), list(READINGS))
    claims = {reading: error_claims(found, reading, source) for reading in READINGS}
    figures = [
        error_figure(found, reading, f"{source}; {CALLED[reading]}", layout.unit, f"4.4-{_file(source)}-{reading}")
        for reading in FIGURES
    ]
    notes = [*_notes(_of_kind(pairs, "baseline"), layout, source), _which(claims, source)]
    return Findings(tuple(claims["printed"]), tuple(figures), (_table(found, source, layout.unit),), tuple(notes))


def _file(source: str) -> str:
    return source.replace(", ", "-").replace(" ", "-")


def _layout(pairs: Sequence[Pair]) -> Layout:
    signals = next((cell["stream"]["signals"] for cell, _ in pairs if "signals" in cell["stream"]), None)
    return BENTO if signals is None else next(each for each in LAYOUTS if set(each.needed) == set(signals))


def _which(claims: dict[str, list[Claim]], source: str) -> str:
    told = [f"{reproduced(each)} with {CALLED[reading]}" for reading, each in claims.items()]
    return (
        f"{source}: of {len(claims['printed'])} claims about errors come out {', '.join(told)}. Listed are those "
        "with the first, as it is printed; with the last, all representations learn at the same pace."
    )


def _notes(baselines: Sequence[Pair], layout: Layout, source: str) -> Iterator[str]:
    yield f"{source}: {baselines[0][1]['told']}."
    if layout.stands_in:
        yield f"{source}: {layout.stands_in}."
    mean, stays, constant = (np.mean([row[name] for _, row in baselines]) for name in BASELINES)
    yield (
        f"To tell errors by ({source}): the mean of all before errs by {mean:.3g} {layout.unit}; that the signal "
        f"stays as it is, which the representations do not see, by {stays:.3g}. One feature that is always active, "
        f"learning as fast as 8,000 prototypes, errs by {constant:.3g}: it tells no state from another, but "
        "follows the signal, as learning goes on while errors are taken."
    )


def _table(found: Sequence[Point], where: str, unit: str) -> Table:
    """Return the best of each kind, by dimensions and reading."""
    rows = []
    for dimensions in DIMENSIONS:
        for called, sized in (("tile coding", False), ("selective Kanerva", True)):
            own = [point for point in found if point.dimensions == dimensions and bool(point.size) is sized]
            for reading in READINGS:
                best = min(own, key=lambda point: point.mean(reading))
                rows.append((str(dimensions), called, CALLED[reading], best.called, f"{best.mean(reading):.4g}",
                             f"{best.step * 1e6:.3g}"))  # fmt: skip
    caption = f"The best of each kind ({where})."
    head = ("dimensions", "representation", "step size", "configuration", f"error ({unit})", "µs a step")
    return Table(caption, head, tuple(rows))
