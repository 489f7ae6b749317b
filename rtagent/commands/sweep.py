"""`rtagent sweep`: run a scenario with many values of some of its keys, and write a table of the results."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rtagent.commands.measuring import Measuring, processors
from rtagent.commands.overrides import overrides
from rtagent.errors import ScenarioError, SweepError
from rtagent.sweeps.compute import Failure, MeasuringError, compute
from rtagent.sweeps.plan import Plan, Run, plan
from rtagent.sweeps.running import DONE, measure_run
from rtagent.sweeps.tables import check_place, write_table

Row = Mapping[str, Any]


def sweep_command(arguments: argparse.Namespace) -> int:
    """Run a sweep; return 0 when all of it was done, 1 where a run ended early or failed, 2 where it cannot be."""
    try:
        planned = plan(arguments.scenario, overrides(arguments.scenario, arguments), arguments.over, arguments.runs)
        out = Path(arguments.out or f"{planned.name}.csv")
        _check(planned, out, arguments)
        jobs = arguments.jobs or (1 if planned.real else processors())
        rows = _measured(planned, out, jobs, arguments)
    except (ScenarioError, SweepError) as error:
        sys.stderr.write(f"{error}\n")
        return _tell_failures(error.failures) if isinstance(error, MeasuringError) else 2
    except KeyboardInterrupt:
        sys.stderr.write("\nStopped. What was measured is kept: the same command goes on.\n")
        return 1
    _write(planned, rows, out)
    return _tell_end(planned, rows, out)


def _check(planned: Plan, out: Path, arguments: argparse.Namespace) -> None:
    """Refuse, before anything runs, what would lose something or move hardware for several at once."""
    check_place(out)
    if out.exists() and not cells_beside(out).exists():
        raise SweepError(f"--out {out}: that is there already, and would be lost: give another name.")
    if arguments.jobs is not None and arguments.jobs < 1:
        raise SweepError(f"--jobs {arguments.jobs}: give 1 or more.")
    several = arguments.cluster or (arguments.jobs or 1) > 1
    if planned.guarded and several:
        raise SweepError("these runs move hardware, of which there is one: run them with --jobs 1, or take --fake.")
    if planned.real and several:
        sys.stderr.write(
            "note: runs under the real clock disturb each other's times: measure them with --jobs 1.\n"
        )


def cells_beside(out: Path) -> Path:
    """Return the file that keeps finished runs, beside their table."""
    return out.with_suffix(".cells")


def _measured(planned: Plan, out: Path, jobs: int, arguments: argparse.Namespace) -> list[Row]:
    cells = [{"scenario": run.scenario} for run in planned.runs]
    told = None if arguments.quiet else sys.stdout
    if told:
        where = f"on {arguments.cluster}" if arguments.cluster else f"{jobs} at a time"
        told.write(f"{planned.name}: {planned.combinations} combinations, {len(cells)} runs, {where}\n")
    with Measuring(cells, told) as measuring:
        return compute(
            measure_run,
            cells,
            store=cells_beside(out),
            jobs=jobs,
            cluster=arguments.cluster,
            finished=measuring.finished,
            damaged=measuring.damaged,
        )


def _write(planned: Plan, rows: Sequence[Row], out: Path) -> None:
    """Write the table, and the scenario of each run under its number beside it."""
    import tomli_w

    folder = out.with_suffix(".scenarios")
    folder.mkdir(exist_ok=True)
    for old in folder.glob("[0-9]*.toml"):  # a sweep with more runs may have been there
        old.unlink()
    for number, run in enumerate(planned.runs):
        (folder / f"{number:04}.toml").write_text(tomli_w.dumps(run.scenario), encoding="utf-8")
    write_table(
        out, [_row(number, run, row) for number, (run, row) in enumerate(zip(planned.runs, rows, strict=True))]
    )


def _row(number: int, run: Run, row: Row) -> Row:
    return {"run": number, **run.values, "seed": run.seed, **row}


def _tell_end(planned: Plan, rows: Sequence[Row], out: Path) -> int:
    early = [(number, row["ended"]) for number, row in enumerate(rows) if row["ended"] != DONE]
    for number, why in early:
        sys.stderr.write(f"run {number} ended early: {why}\n")
    sys.stdout.write(f"{len(rows)} runs are in {out}, their scenarios in {out.with_suffix('.scenarios')}\n")
    return 1 if early else 0


def _tell_failures(failures: Sequence[Failure]) -> int:
    for failure in failures[:1]:
        sys.stderr.write(failure.trace)
    return 1
