"""A scenario compared with its figures in a baseline, or with the same under another revision."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec

from rtagent.errors import BaselineError, UndecidedError
from rtagent.latencies.baseline import Baseline
from rtagent.latencies.changes import Change, Compared, Verdict, of_exact, of_times, uncounted
from rtagent.latencies.comparison import to_stored
from rtagent.latencies.figures import Exact, Figures, is_real, some_reactions
from rtagent.latencies.processes import Command, Worker, beside, scenario_command, workers
from rtagent.latencies.rounds import Rules, Tell

STORED_LIMIT, BESIDE_LIMIT = 2.0, 1.1
"""Above it is a regression: where times were stored by another session, and where both sides took turns."""

BESIDE_ROUNDS = 12

NOTHING_LEFT = "Nothing is left to compare: save a new baseline with --save."
HERE = "here"


def refusal(baseline: Baseline) -> str:
    """Return why nothing at all of a baseline can be compared, or nothing."""
    refused = [sentence for sentence in (baseline.times_differ_by(), baseline.counts_differ_by()) if sentence]
    return " ".join([*refused, NOTHING_LEFT]) if len(refused) == 2 else ""


def with_stored(baseline: Baseline, now: Figures, rules: Rules, limit: float = STORED_LIMIT) -> Compared:
    """Compare figures with the baseline's of the same scenario; raise `BaselineError` where it has none."""
    stored = baseline.of(now)
    changes, notes = list[Change](), list[str]()
    if sentence := baseline.times_differ_by():
        notes.append(sentence)
    else:
        changes += _stored_times(baseline, stored, now, rules, limit)
    if sentence := baseline.counts_differ_by():
        notes.append(sentence)
    else:
        changes += of_exact(stored.exact, now.exact)
        notes += uncounted(stored.exact, now.exact)
    return Compared(now.name, str(baseline.path), limit, changes, notes, _both_reactions(stored, now))


def _stored_times(
    baseline: Baseline, stored: Figures, now: Figures, rules: Rules, limit: float
) -> Iterator[Change]:
    if now.busy:
        yield Change("times", "", "", now.busy, Verdict.UNSURE)
    elif stored.times.values:
        yield from of_times(to_stored(str(baseline.path), now.name, stored.times, now.times, rules), limit)


def _both_reactions(stored: Figures, now: Figures) -> tuple[list[int], list[int]]:
    both = (stored, now)
    before, after = (list(each.reactions or each.exact.reactions) for each in both)
    return before, after


def with_revision(
    revision: str,
    python: Path,
    figures: Figures,
    rules: Rules,
    limit: float = BESIDE_LIMIT,
    tell: Tell = lambda line: None,
) -> Compared:
    """Measure a scenario here and by the interpreter of another revision, in turns, and compare.

    Raises `BaselineError` where that revision cannot be measured.
    """
    before, after = (
        (name, scenario_command(interpreter, figures.path, figures.keys))
        for name, interpreter in ((revision, python), (HERE, sys.executable))
    )
    tell(f"{figures.name}: counting, under the virtual clock")
    with workers(before, after) as both:
        then, now = map(_exact, both)
    changes, notes = list(of_exact(then, now)), list(uncounted(then, now))
    reactions = list(then.reactions), list(now.reactions)
    if is_real(figures):
        times, reactions = _turns(before, after, rules, limit, lambda line: tell(f"{figures.name}: {line}"))
        changes[:0] = times
    return Compared(figures.name, revision, limit, changes, notes, reactions)


def _turns(
    before: tuple[str, Command],
    after: tuple[str, Command],
    rules: Rules,
    limit: float,
    tell: Tell,
) -> tuple[list[Change], tuple[list[int], list[int]]]:
    try:
        comparison, rounds = beside(before, after, rules, limit, tell=tell)
    except UndecidedError as error:
        return [Change("times", "", "", str(error), Verdict.UNSURE)], ([], [])
    then, now = (some_reactions([each.blocks[side] for each in rounds]) for side in range(2))
    return list(of_times(comparison, limit)), (then, now)


def _exact(worker: Worker) -> Exact:
    try:
        return msgspec.convert(worker.ask("exact"), Exact)
    except msgspec.ValidationError as error:
        raise BaselineError(f"{worker.name} counts in another way ({error}): compare with a later one.") from None
