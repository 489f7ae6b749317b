"""`rtagent reproduce`: the experiments of the thesis, each with one command, and a report of all that was found."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from rtagent import clock, plugins
from rtagent.commands.measuring import Measuring, in_words, processors
from rtagent.errors import PluginError, SweepError
from rtagent.experiments.experiment import Cell, Experiment, Options, Row, Verdict
from rtagent.experiments.known import GROUP, chosen, experiment, in_order
from rtagent.experiments.outcome import Outcome, carry_out
from rtagent.experiments.report.machine import machine, versions
from rtagent.experiments.report.page import About, page
from rtagent.sweeps.compute import compute
from rtagent.sweeps.store import key_of
from rtagent.sweeps.workers import connected

COLORS = {
    Verdict.REPRODUCED: "green",
    Verdict.DIFFERS: "yellow",
    Verdict.NOT_REPRODUCED: "red",
    Verdict.UNDECIDED: "blue",
}


def reproduce_command(arguments: argparse.Namespace) -> int:
    """List the experiments, or do some; return 0 when all were done, 1 where one failed, 2 where none can be."""
    options = Options(arguments.quick, None if arguments.data is None else Path(arguments.data))
    if not arguments.names:
        return _list(Console(highlight=False), options)
    try:
        experiments = chosen(arguments.names)
        out = Path(arguments.out)
        _check(options, out, arguments)
    except (PluginError, SweepError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return _reproduce(experiments, options, out, arguments)


def _check(options: Options, out: Path, arguments: argparse.Namespace) -> None:
    """Refuse, before anything runs, what would fail at the end."""
    if options.data is not None and not options.data.is_file():
        raise SweepError(f"--data {options.data}: there is no such file.")
    if arguments.jobs is not None and arguments.jobs < 1:
        raise SweepError(f"--jobs {arguments.jobs}: give 1 or more.")
    if find_spec("matplotlib") is None:
        raise SweepError("figures need the package matplotlib: pip install 'rtagent[figures]'.")
    if arguments.cluster is not None:
        connected(arguments.cluster).close()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SweepError(f"--out {out}: there can be no such folder: {error.strerror}.") from None


def _reproduce(
    experiments: Sequence[Experiment], options: Options, out: Path, arguments: argparse.Namespace
) -> int:
    console, jobs = Console(highlight=False), arguments.jobs or processors()
    now, began, outcomes, stopped = clock.RealClock().now, clock.RealClock().now(), list[Outcome](), False
    _tell_plan(console, experiments, options, jobs)
    for each in experiments:
        console.print(f"[bold]{each.name}[/bold]: {each.title}")
        try:
            outcomes.append(_carried_out(each, options, out, jobs, arguments.cluster))
        except KeyboardInterrupt:
            sys.stderr.write("\nStopped. What was measured is kept: the same command goes on.\n")
            stopped = True
            break
    took = (now() - began) / 1e9
    index = _write(outcomes, out, _about(arguments, took))
    _tell_claims(console, outcomes)
    console.print(f"\n{index}: took {in_words(took)}")
    return 1 if stopped or any(outcome.failures for outcome in outcomes) else 0


def _carried_out(experiment: Experiment, options: Options, out: Path, jobs: int, cluster: str | None) -> Outcome:
    measured = 0.0

    def measurements(experiment: Experiment, cells: Sequence[Cell]) -> Sequence[Row]:
        nonlocal measured
        with Measuring(cells, sys.stdout, experiment.seconds) as measuring:
            try:
                return compute(
                    experiment.measure,
                    cells,
                    store=_store(experiment, out),
                    jobs=1 if experiment.alone else jobs,
                    cluster=None if experiment.alone else cluster,
                    finished=measuring.finished,
                    damaged=measuring.damaged,
                )
            finally:
                measured = measuring.seconds

    outcome = carry_out(experiment, options, measurements, out / "figures")
    for failed in outcome.failures:
        sys.stderr.write(f"{failed.trace}{experiment.name} failed: {failed.sentence}\n")
    return replace(outcome, seconds=measured)


def _store(experiment: Experiment, out: Path) -> Path:
    """Return where measurements are kept: with those of other experiments that measure by the same function."""
    return out / "cells" / f"{experiment.measure.__module__}.cells"


def _needed(experiments: Sequence[Experiment], options: Options, jobs: int) -> float:
    """Return how long (s) experiments will take, where what they have in common is measured once."""
    needed: dict[str, float] = {}
    for each in experiments:
        for cell in each.cells(options):
            needed[key_of(each.measure, cell)] = each.seconds(cell) / (1 if each.alone else jobs)
    return sum(needed.values())


def _tell_plan(console: Console, experiments: Sequence[Experiment], options: Options, jobs: int) -> None:
    try:
        needed = _needed(experiments, options, jobs)
    except Exception:  # an experiment whose cells fail is told when its turn comes
        return
    console.print(
        f"{len(experiments)} experiments, {jobs} at a time: about {in_words(needed)}, if nothing is kept yet"
    )


def _list(console: Console, options: Options) -> int:
    table = Table("experiment", "what it is", "thesis", "--quick", "in full", box=None, pad_edge=False)
    table.columns[0].no_wrap = True
    found, code = list[Experiment](), 0
    for name in plugins.names(GROUP):
        try:
            found.append(experiment(name))
        except PluginError as error:  # one that is broken must not hide the others
            sys.stderr.write(f"{error}\n")
            code = 1
    for each in in_order(found):
        times = [_told_need(each, replace(options, quick=quick)) for quick in (True, False)]
        on_demand = " (not part of all)" if each.on_demand else ""
        table.add_row(each.name, f"{each.title}{on_demand}", each.thesis, *times)
    console.print(table)
    console.print(f"\nTimes are for {processors()} processors. rtagent reproduce NAME, or all.")
    return code


def _told_need(experiment: Experiment, options: Options) -> str:
    try:
        return in_words(_needed([experiment], options, processors()))
    except Exception:  # why its cells cannot be listed is told when it is done
        return "unknown"


def _about(arguments: argparse.Namespace, took: float) -> About:
    words = ["rtagent", "reproduce", *arguments.names, *["--quick"] * arguments.quick]
    words += ["--data", arguments.data] if arguments.data else []
    when = f"{datetime.now().astimezone():%d %B %Y, %H:%M %Z}"
    return About(shlex.join(words), when, in_words(took), versions(), machine(), arguments.quick)


def _write(outcomes: Sequence[Outcome], out: Path, about: About) -> Path:
    """Write the page, and the claims as JSON beside it."""
    index = out / "index.html"
    index.write_text(page(outcomes, about), encoding="utf-8")
    claims = {outcome.experiment.name: _plain(outcome) for outcome in outcomes}
    (out / "claims.json").write_text(json.dumps(claims, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    return index


def _plain(outcome: Outcome) -> dict[str, object]:
    return {
        "thesis": outcome.experiment.thesis,
        "claims": [asdict(claim) for claim in outcome.findings.claims],
        "failures": [failed.sentence for failed in outcome.failures],
        "cells": len(outcome.cells),
        "seconds": round(outcome.seconds, 1),
    }


def _tell_claims(console: Console, outcomes: Sequence[Outcome]) -> None:
    table = Table("experiment", "verdict", "claim", box=None, pad_edge=False)
    for column in table.columns[:2]:
        column.no_wrap = True
    for outcome in outcomes:
        for claim in outcome.findings.claims:
            verdict = f"[{COLORS[claim.verdict]}]{claim.verdict.value}[/]"
            table.add_row(outcome.experiment.name, verdict, escape(claim.said))
    if table.rows:
        console.print()
        console.print(table)
