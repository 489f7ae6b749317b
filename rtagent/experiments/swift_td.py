"""SwiftTD against true online TD(λ), on the streams of chapters 4 and 5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from rtagent.experiments import beyond
from rtagent.experiments.beyond import STREAMS, UNITS, Problem, problem
from rtagent.experiments.chunks import Follows, follow_chunks
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Table, Verdict
from rtagent.experiments.statistics import Interval, below, interval
from rtagent.experiments.streams import part_error
from rtagent.experiments.style import boxes
from rtagent.features import SelectiveKanerva
from rtagent.learning import SwiftTD, TrueOnlineTD

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

TRUE_ONLINE, SWIFT = "true online TD(λ)", "SwiftTD"
ALPHAS = (0.01, 0.03, 0.1, 0.3, 0.6, 1.0)
"""Step sizes of all active features together that are tried with true online TD(λ)."""
FIRST_ALPHAS, META_STEP_SIZES, BOUND = (0.01, 0.1, 0.3), (1e-3, 1e-2, 1e-1), 0.5
"""Those that SwiftTD begins with, the step sizes of their logarithms, and the bound on its rate of learning."""
PROTOTYPES, QUICK_PROTOTYPES = 8000, 2000
SEEDS, QUICK_SEEDS = 20, 5
CHOSEN_FROM = 0.75
"""Settings are chosen by the errors before the test, from this part of that time on."""


def cells(options: Options) -> list[Cell]:
    """Return a cell for each stream and seed of prototypes."""
    size, seeds = (QUICK_PROTOTYPES, QUICK_SEEDS) if options.quick else (PROTOTYPES, SEEDS)
    return beyond.cells((size,), seeds, options)


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return float(0.5 + beyond.rows_of(cell) * (8e-6 + 6e-9 * cell["prototypes"]))


def measure(cell: Cell) -> Row:
    """Return, for each learner and setting, the errors by which settings are chosen, and those of the test."""
    given = problem(cell["stream"], cell["every"])
    made = {"prototypes": cell["prototypes"], "eta": cell["eta"], "seed": cell["seed"]}
    coder = SelectiveKanerva(state=given.state, **made)
    learners = _learners(given, coder)
    cumulants = dict.fromkeys(learners, given.cumulants)
    predicted = follow_chunks(given.states, coder, learners, cumulants, given.until)
    parts = {"chosen by": slice(round(CHOSEN_FROM * given.tested), given.tested), "test": slice(given.tested, None)}
    errors = {
        f"{learner}, {setting}": {name: part_error(found, given.truth, part) for name, part in parts.items()}
        for (learner, setting), found in predicted.items()
    }
    plain = {key: None if np.isnan(each["test"]) else each for key, each in errors.items()}
    return {"errors": plain, "rows": len(given.states), "told": given.told}


def _learners(given: Problem, coder: SelectiveKanerva) -> dict[tuple[str, str], Follows]:
    common: dict[str, Any] = {
        "size": coder.size,
        "active": coder.active,
        "gamma": given.gamma,
        "lambda_": given.lambda_,
    }
    learners: dict[tuple[str, str], Follows] = {
        (TRUE_ONLINE, f"α {alpha:g}"): TrueOnlineTD(alpha=alpha, **common) for alpha in ALPHAS
    }
    for alpha, meta in product(FIRST_ALPHAS, META_STEP_SIZES):
        setting = f"α {alpha:g}, meta step size {meta:g}"
        learners[SWIFT, setting] = SwiftTD(alpha=alpha, meta_step_size=meta, eta=BOUND, **common)
    return learners


Errors = Mapping[str, Sequence[Mapping[str, float] | None]]
"""By learner and setting, an entry a seed; None where it diverged."""


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Return which of both errs less, with the settings that did best before the test."""
    by_stream = {stream: _errors(pairs, stream) for stream in STREAMS}
    chosen = {stream: best(errors) for stream, errors in by_stream.items()}
    claims = tuple(_claim(stream, by_stream[stream], chosen[stream]) for stream in STREAMS)
    return Findings(claims, (_figure(by_stream, chosen, pairs),), (_table(by_stream, chosen),))


def _errors(pairs: Sequence[tuple[Cell, Row]], stream: str) -> Errors:
    rows = [row["errors"] for cell, row in pairs if cell["stream"] == stream]
    return {key: [row[key] for row in rows] for key in rows[0]}


def best(errors: Errors) -> dict[str, str]:
    """Return each learner's setting with the least mean error before the test, among those that diverged least."""
    found = {}
    for learner in (TRUE_ONLINE, SWIFT):
        settings = {key: several for key, several in errors.items() if key.startswith(f"{learner}, ")}
        found[learner] = min(settings, key=lambda key: _rank(settings[key]))
    return found


def _rank(several: Sequence[Mapping[str, float] | None]) -> tuple[int, float]:
    """Return how often learning diverged, and the mean error before the test where it did not."""
    before = [each["chosen by"] for each in several if each]
    return len(several) - len(before), float(np.mean(before)) if before else np.inf


def tested(errors: Errors, key: str) -> list[float]:
    """Return the errors of the test, one a seed for which learning did not diverge."""
    return [each["test"] for each in errors[key] if each]


def compared_to(errors: Errors, chosen: Mapping[str, str]) -> Interval:
    """Return how many times SwiftTD's error is that of true online TD(λ), seed by seed."""
    pairs = zip(tested(errors, chosen[SWIFT]), tested(errors, chosen[TRUE_ONLINE]), strict=True)
    return interval([ours / others for ours, others in pairs])


def _claim(stream: str, errors: Errors, chosen: Mapping[str, str]) -> Claim:
    ours, verdict = _compared(errors, chosen)
    return Claim(
        f"SwiftTD errs less than true online TD(λ) on the {stream} stream, each with its best settings",
        "not in the thesis; its authors find so in predictions on Atari games (Javed and others 2024)",
        ours,
        verdict,
    )


def _compared(errors: Errors, chosen: Mapping[str, str]) -> tuple[str, Verdict]:
    """Return what was found, and the verdict; a learner that diverges with every setting errs more."""
    diverged = [learner for learner, key in chosen.items() if None in errors[key]]
    if diverged:
        verdict = Verdict.REPRODUCED if diverged == [TRUE_ONLINE] else Verdict.NOT_REPRODUCED
        return f"{' and '.join(diverged)} diverged with every setting", verdict
    found = compared_to(errors, chosen)
    return f"{found} times the error; settings: {chosen[SWIFT]}; {chosen[TRUE_ONLINE]}", below(found, 1.0)


def _table(by_stream: Mapping[str, Errors], chosen: Mapping[str, Mapping[str, str]]) -> Table:
    rows = []
    for stream, errors in by_stream.items():
        for key, several in errors.items():
            mark = "best" if key in chosen[stream].values() else ""
            diverged = sum(each is None for each in several)
            told = [str(interval([each[part] for each in several if each])) for part in ("chosen by", "test")]
            rows.append((stream, key, *(told if not diverged else [f"diverged, {diverged} seeds"] * 2), mark))
    head = ("stream", "learner", "error before the test", "error of the test", "")
    return Table(
        "Mean absolute errors of all settings that were tried, with intervals over seeds.", head, tuple(rows)
    )


def _figure(by_stream: Mapping[str, Errors], chosen: Mapping[str, Mapping[str, str]], pairs: Any) -> Figure:
    cell, seeds = pairs[0][0], len({cell["seed"] for cell, _ in pairs})
    told = "; ".join({row["told"]: None for _, row in pairs})
    caption = (
        f"Mean absolute errors of the test, {seeds} seeds of {cell['prototypes']:,} prototypes, η {cell['eta']}, "
        f"with the settings that did best before it; {told}."
    )
    return Figure("errors", caption, partial(_draw, by_stream=by_stream, chosen=chosen), (6.5, 3.5))


def _draw(canvas: Canvas, by_stream: Mapping[str, Errors], chosen: Mapping[str, Mapping[str, str]]) -> None:
    for axes, (stream, errors) in zip(canvas.subplots(1, len(by_stream)), by_stream.items(), strict=True):
        for number, (learner, key) in enumerate(chosen[stream].items()):
            boxes(axes, number, [tested(errors, key)], [number], learner)
        axes.set_xticks(range(len(chosen[stream])), list(chosen[stream]))
        axes.set_xlabel("learner")
        axes.set_title(stream)
        axes.set_ylabel(f"mean absolute error ({UNITS[stream]})")
        axes.set_ylim(bottom=0)


EXPERIMENT = Experiment(
    name="swift-td",
    title="SwiftTD against true online TD(λ)",
    thesis="Not in it; on the streams of chapters 4 and 5",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=(beyond.MODELLED,),
)
