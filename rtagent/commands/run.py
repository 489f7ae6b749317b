"""`rtagent run`: run a scenario, show its progress, print and write its results."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rtagent import __version__
from rtagent.checkpoint.keeper import Keeper
from rtagent.commands.checkpoints import keeper_of, told
from rtagent.commands.onlooker import Onlooker
from rtagent.commands.overrides import overrides
from rtagent.errors import CheckpointError, RtagentError, ScenarioError
from rtagent.latch import Latch
from rtagent.realtime import Manners, manners
from rtagent.result import Result, RunError
from rtagent.runtime import Habits
from rtagent.scenario import Assembly, Scenario, assemble, load
from rtagent.timeline import Timeline
from rtagent.timeline import write as write_trace

if TYPE_CHECKING:
    from rtagent.commands.human import Human
    from rtagent.telemetry.link import Link


def run_command(arguments: argparse.Namespace) -> int:
    """Run a scenario; return 0 when it was done, 1 after a fault, 2 where it cannot be run."""
    try:
        _check_output("--json", arguments.json)
        _check_output("--trace", arguments.trace)
        _check_recording(arguments.record)
        scenario, assembly, human = _prepared(arguments)
        keeper = keeper_of(scenario, resume=arguments.resume)
    except (ScenarioError, CheckpointError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    with manners(assembly.realtime, scenario.model.run.clock, busy=assembly.never_sleeps) as granted:
        return _run(scenario, assembly, granted, keeper, arguments, human)


def _prepared(arguments: argparse.Namespace) -> tuple[Scenario, Assembly, Human | None]:
    """Return what is to be run, and who plays it, if anybody does."""
    given = overrides(arguments.scenario, arguments)
    if arguments.human is None:
        scenario = load(arguments.scenario, given)
        return scenario, assemble(scenario), None
    from rtagent.commands.human import prepare  # needs what not every system that can run fakes has

    scenario, human = prepare(arguments.scenario, given, arguments)
    return scenario, human.assembly, human


def _run(
    scenario: Scenario,
    assembly: Assembly,
    granted: Manners,
    keeper: Keeper | None,
    arguments: argparse.Namespace,
    human: Human | None,
) -> int:
    out = sys.stderr if arguments.json == "-" else sys.stdout
    if keeper is not None and keeper.resumed is not None and not arguments.quiet:
        out.write(f"{told(keeper, keeper.resumed)}\n")
    company = human or Onlooker(scenario, assembly, granted, None if arguments.quiet else out)
    timeline = Timeline() if arguments.trace else None
    refused = _tell_refused(granted.refused)
    result, failure = None, None
    latch = Latch()
    if not company.begin(latch, out):
        company.close()
        return 1
    telemetry = _open_telemetry(scenario, assembly, latch, arguments.record)
    try:
        habits = Habits(granted.calm, granted.place_learner)
        heard = (*company.instruments, timeline, telemetry and telemetry.collector)
        run = assembly.run([each for each in heard if each is not None], habits, latch, keeper)
        result = granted.run(company.accompany(run))
    except RunError as error:
        result, failure = error.result, error
    except RtagentError as error:
        sys.stderr.write(f"{arguments.scenario}: {error}\n")
        return 2
    finally:
        company.close()
        if telemetry:
            _tell_refused(telemetry.close(_end_in_words(result, failure)))
    company.tell(result)
    _tell_refused(granted.refused[refused:])
    if failure is not None:
        _print_failure(failure)
    _write(scenario, {**result.as_dict(), "realtime": granted.as_dict(), **company.as_dict()}, arguments.json)
    traced = timeline is None or _write_trace(timeline, scenario, result, arguments.trace)
    return 0 if failure is None and not result.not_safe and result.learned_all and traced else 1


def _write_trace(timeline: Timeline, scenario: Scenario, result: Result, path: str) -> bool:
    """Write the timeline, tell what it lacks, and say whether it could be written."""
    about = {"scenario": scenario.name, "clock": result.clock, "seed": result.seed, "rtagent": __version__}
    try:
        write_trace(timeline, path, about)
    except OSError as error:
        sys.stderr.write(f"--trace {path}: {error.strerror or error}: nothing to rely on was written there.\n")
        return False
    if timeline.dropped:
        sys.stderr.write(
            f"note: {path} lacks the oldest {timeline.dropped:,} things that happened: "
            "it holds what came last; trace a shorter run to have all.\n"
        )
    return True


def _end_in_words(result: Result | None, failure: RunError | None) -> str:
    """Return how a run ended, for its telemetry."""
    if failure is not None:
        return str(failure)
    return "done" if result is not None else "it could not be run"


def _open_telemetry(scenario: Scenario, assembly: Assembly, latch: Latch, record: str | None) -> Link | None:
    """Open telemetry where some is wanted; what it lacks is told, and the run goes on without it."""
    if not (scenario.model.published or record):
        return None
    try:
        from rtagent.telemetry.wishes import open_telemetry

        return open_telemetry(scenario, assembly, latch, record)
    except ImportError as error:
        _tell_refused([f"there is no telemetry: it needs the package {error.name}: pip install {error.name}."])
    except (OSError, AttributeError) as error:  # no memory to share, or another system
        _tell_refused([f"there is no telemetry: this machine has not what it needs: {error}."])
    return None


def _tell_refused(sentences: Sequence[str]) -> int:
    for sentence in sentences:
        sys.stderr.write(f"note: {sentence}\n")
    return len(sentences)


def _check_output(option: str, path: str | None) -> None:
    """Refuse, before anything runs, a place that results cannot be written to."""
    if path is None or (path == "-" and option == "--json"):
        return
    target = Path(path)
    if not path or target.is_dir() or not target.parent.is_dir():
        raise ScenarioError([f"{option} {path}: give a file in a folder that exists."])


def _check_recording(path: str | None) -> None:
    """Refuse, before anything runs, to record over something, or where nothing can be."""
    if path is None:
        return
    if Path(path).exists():
        raise ScenarioError([f"--record {path}: that is there already, and would be lost: give another name."])
    if not Path(path).absolute().parent.is_dir():
        raise ScenarioError([f"--record {path}: give a file in a folder that exists."])


def _print_failure(failure: RunError) -> None:
    for fault in failure.result.faults:
        if fault.fatal and fault.traceback:
            sys.stderr.write(fault.traceback)
    safe = "Not everything is safe" if failure.result.not_safe else "All devices were made safe"
    sys.stderr.write(f"The run ended early: {failure}\n{safe}.\n")
    for sentence in failure.result.not_safe:
        sys.stderr.write(f"  {sentence}\n")


def _write(scenario: Scenario, result: dict[str, Any], path: str | None) -> None:
    if path is None:
        return
    resolved = scenario.resolved()
    data = {"scenario": scenario.name, **result, "resolved": resolved}
    text = json.dumps(data, indent=2) + "\n"
    if path == "-":
        sys.stdout.write(text)
        return
    import tomli_w

    target = Path(path)
    target.write_text(text, encoding="utf-8")
    target.with_suffix(".scenario.toml").write_text(tomli_w.dumps(resolved), encoding="utf-8")
