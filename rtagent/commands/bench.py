"""`rtagent bench`: what scenarios take, kept as a baseline, compared with one, or with another revision."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rtagent.commands.bench_plot import draw, is_there
from rtagent.commands.bench_report import as_markdown, print_compared, print_figures, print_floor
from rtagent.errors import BaselineError, RtagentError, ScenarioError, SpecError, UndecidedError
from rtagent.latencies.baseline import Baseline, read, write
from rtagent.latencies.changes import Compared
from rtagent.latencies.comparing import (
    BESIDE_LIMIT,
    BESIDE_ROUNDS,
    STORED_LIMIT,
    refusal,
    with_revision,
    with_stored,
)
from rtagent.latencies.figures import Figures, measured, unmeasured
from rtagent.latencies.revision import installed
from rtagent.latencies.rounds import Measure, Rules, floor, interleaved

ROUNDS = 10

OUTPUTS = ("save", "markdown", "plot")
NOTHING_TO_DO = "give a scenario to measure, a baseline with --compare, or --floor."


def bench_command(arguments: argparse.Namespace) -> int:
    """Measure and compare; return 0, 1 where something got worse or could not be measured, 2 for bad usage."""
    try:
        _check(arguments)
        rules = _rules(arguments)
        if arguments.floor:
            print_floor(interleaved([Measure(floor)], rules), sys.stdout)
            return 0
        return _against(arguments, rules) if arguments.against else _bench(arguments, rules)
    except (ScenarioError, BaselineError, SpecError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except UndecidedError as error:
        sys.stderr.write(f"undecided: {error}\n")
    except (RtagentError, KeyboardInterrupt) as error:
        sys.stderr.write(f"{str(error) or 'interrupted.'}\n")
    return 1


def _bench(arguments: argparse.Namespace, rules: Rules) -> int:
    baseline = read(Path(arguments.compare)) if arguments.compare else None
    scenarios = _scenarios(arguments, baseline)
    if baseline is not None:
        _check_fit(baseline, scenarios)
    found = [measured(each, rules, _tell) for each in scenarios]
    if arguments.save:
        _save(Path(arguments.save), found)
    if baseline is None:
        for figures in found:
            print_figures(figures, sys.stdout)
        return 0
    limit = arguments.limit or STORED_LIMIT
    return _told([with_stored(baseline, figures, rules, limit) for figures in found], arguments)


def _against(arguments: argparse.Namespace, rules: Rules) -> int:
    scenarios, revision = _scenarios(arguments, None), arguments.against
    python, limit = installed(revision, _tell), arguments.limit or BESIDE_LIMIT
    return _told([with_revision(revision, python, each, rules, limit, _tell) for each in scenarios], arguments)


def _told(scenarios: Sequence[Compared], arguments: argparse.Namespace) -> int:
    """Print comparisons, write what was asked for, and return the exit code."""
    for compared in scenarios:
        print_compared(compared, sys.stdout)
    if arguments.markdown:
        Path(arguments.markdown).write_text(as_markdown(scenarios), encoding="utf-8")
    if arguments.plot:
        draw(scenarios, Path(arguments.plot))
    worse = any(compared.regressions for compared in scenarios)
    undecided = any(compared.undecided for compared in scenarios)
    return int(worse or (arguments.strict and undecided))


def _scenarios(arguments: argparse.Namespace, baseline: Baseline | None) -> list[Figures]:
    """Return what is to be measured: the files given, else those of the baseline; raise `SpecError`."""
    episodes = [] if arguments.episodes is None else [f"run.episodes={arguments.episodes}"]
    keys = [*arguments.set, *episodes]
    found = [unmeasured(path, keys) for path in arguments.scenarios]
    if not found and baseline is not None:
        found = [unmeasured(each.path, [*each.keys, *keys]) for each in baseline.scenarios.values()]
    if not found:
        raise SpecError(f"there is nothing to do: {NOTHING_TO_DO}")
    names = [each.name for each in found]
    if twice := {name for name in names if names.count(name) > 1}:
        raise SpecError(f"two scenarios are called {min(twice)!r}: give each a name of its own.")
    return found


def _check_fit(baseline: Baseline, scenarios: Sequence[Figures]) -> None:
    """Refuse what the baseline cannot be compared with, before anything is measured."""
    if sentence := refusal(baseline):
        raise BaselineError(sentence)
    for figures in scenarios:
        baseline.of(figures)


def _save(path: Path, found: Sequence[Figures]) -> None:
    """Write a baseline; raise `UndecidedError` where part of it could not be measured: none is better than half."""
    busy = [figures.busy for figures in found if figures.busy]
    if busy:
        raise UndecidedError(f"{path} was not written: {busy[0]}")
    write(path, found)
    _tell(f"written to {path}")


def _check(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be done, before anything is measured; raise `SpecError`."""
    for option in OUTPUTS:
        path = getattr(arguments, option)
        if path is not None and (not Path(path).parent.is_dir() or Path(path).is_dir()):
            raise SpecError(f"--{option} {path}: give a file in a folder that exists.")
    chosen = [f"--{name}" for name in ("floor", "against", "compare") if getattr(arguments, name)]
    if len(chosen) > 1 or (arguments.save and chosen and chosen != ["--compare"]):
        raise SpecError(f"{' and '.join(chosen)} do not go together{' with --save' * bool(arguments.save)}.")
    if not chosen and (arguments.plot or arguments.markdown):
        raise SpecError("--plot and --markdown show a comparison: give --compare or --against too.")
    if arguments.save and arguments.save == arguments.compare:
        raise SpecError(f"{arguments.save} would be lost: save to another file.")
    if arguments.plot and not is_there():
        raise SpecError("--plot needs matplotlib: pip install 'rtagent[figures]'.")
    if arguments.limit is not None and not arguments.limit >= 1:
        raise SpecError(f"--limit {arguments.limit:g} is below 1: give how many times as long is allowed.")


def _rules(arguments: argparse.Namespace) -> Rules:
    rounds = arguments.rounds or (BESIDE_ROUNDS if arguments.against else ROUNDS)
    return Rules(rounds=rounds, processor=arguments.processor, stolen=arguments.stolen)


def _tell(line: str) -> None:
    sys.stderr.write(f"{line}\n")
