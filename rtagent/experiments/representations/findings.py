"""What is found in all that was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rtagent.experiments.experiment import Claim, Figure, Findings, Options, Table
from rtagent.experiments.representations.cells import ALPHA, READINGS
from rtagent.experiments.representations.claims import error_claims, reproduced
from rtagent.experiments.representations.configurations import DIMENSIONS
from rtagent.experiments.representations.figures import error_figure, time_figure
from rtagent.experiments.representations.points import Pair, Point, points
from rtagent.experiments.representations.signals import BENTO, LAYOUTS, Layout
from rtagent.experiments.representations.times import table, table_claims, time_claims, timed

CALLED = {"printed": f"α = {ALPHA:g} of each weight", "divided": f"α = {ALPHA:g} / c"}


def find(pairs: Sequence[Pair], options: Options) -> Findings:
    """Return what was found: errors on the simulated arm and on a recording, times, and table 4.1."""
    claims: list[Claim] = []
    figures: list[Figure] = []
    tables: list[Table] = []
    notes: list[str] = []
    for source in ("sorting", "recording"):
        own = [(cell, row) for cell, row in pairs if cell.get("stream", {}).get("name") == source]
        if any(cell["kind"] == "error" for cell, _ in own):
            found = _of_source(own, source)
            claims += found.claims
            figures += found.figures
            tables += found.tables
            notes += found.notes
    times, fitting = _of_kind(pairs, "time"), _of_kind(pairs, "within")
    claims += [*time_claims(times), *table_claims(fitting)]
    figures.append(time_figure(timed(times, plain=True), timed(times, plain=False)))
    tables.append(table(fitting))
    if options.data is None:
        notes.append("No recording was given: --data FILE does the same on one of your own.")
    return Findings(tuple(claims), tuple(figures), tuple(tables), tuple(notes))


def _of_kind(pairs: Sequence[Pair], kind: str) -> list[Pair]:
    return [(cell, row) for cell, row in pairs if cell["kind"] == kind]


def _of_source(pairs: Sequence[Pair], source: str) -> Findings:
    """Return what was found on the simulated arm, or on a recording, under both readings of the step size."""
    errors, baselines = _of_kind(pairs, "error"), _of_kind(pairs, "baseline")
    layout, where = _layout(pairs), "simulated arm" if source == "sorting" else "recording"
    found = points(errors, list(READINGS))
    claims = {reading: error_claims(found, reading, f"{where}, {CALLED[reading]}") for reading in READINGS}
    figures = [
        error_figure(found, reading, f"{where}, {CALLED[reading]}", layout.unit, f"4.4-{source}-{reading}")
        for reading in READINGS
    ]
    all_claims = [claim for each in claims.values() for claim in each]
    notes = [*_notes(baselines, layout, where), _which(claims, where)]
    return Findings(tuple(all_claims), tuple(figures), (_table(found, where, layout.unit),), tuple(notes))


def _layout(pairs: Sequence[Pair]) -> Layout:
    signals = next((cell["stream"]["signals"] for cell, _ in pairs if "signals" in cell["stream"]), None)
    return BENTO if signals is None else next(each for each in LAYOUTS if set(each.needed) == set(signals))


def _which(claims: dict[str, list[Claim]], where: str) -> str:
    counts = {reading: reproduced(each) for reading, each in claims.items()}
    told = ", ".join(f"{counts[reading]} of {len(claims[reading])} with {CALLED[reading]}" for reading in counts)
    return f"Claims about errors that came out on the {where}, by how the step size is read: {told}."


def _notes(baselines: Sequence[Pair], layout: Layout, where: str) -> Iterator[str]:
    yield f"The {where} is {baselines[0][1]['told']}."
    if layout.stands_in:
        yield f"Of the {where}: {layout.stands_in}."
    mean, stays = (np.mean([row[name] for _, row in baselines]) for name in ("mean", "as it is"))
    yield (
        f"To tell errors on the {where} by: the mean of all before errs by {mean:.3g} {layout.unit}, and that the "
        f"signal stays as it is, which the representations do not see, by {stays:.3g}."
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
    caption = f"The best of each kind on the {where}."
    head = ("dimensions", "representation", "step size", "configuration", f"error ({unit})", "µs a step")
    return Table(caption, head, tuple(rows))
