"""`rtagent stop` and `rtagent rearm`: make the hardware of scenarios safe and latch it; let it move again."""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import signal
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rtagent import latched, living
from rtagent.device import Guarded, LastResort
from rtagent.errors import RtagentError, ScenarioError
from rtagent.scenario import load_devices
from rtagent.scenario.load import Part
from rtagent.shutdown import safe_within
from rtagent.units import second
from rtagent.watchdog.resorts import Resort, make_all_safe

A_MOMENT = 1.0
"""How much longer (s) than its devices need a run may take to stop."""


@dataclass(frozen=True)
class Target:
    """A guarded device of a scenario, with its last resort, and how long (s) it may take to be made safe."""

    name: str
    scenario: str
    resort: LastResort
    within: float


def stop_command(arguments: argparse.Namespace) -> int:
    """Make everything safe; return 0 where it is, 1 where something is not."""
    targets, problems = _targets(arguments)
    with _told():
        for target in targets:
            latched.latch(target.resort.hardware, "stopped by rtagent stop", target.scenario)
    with _told():
        _end_runs(arguments.scenarios, targets)
    not_safe = _make_safe(targets)
    if not targets and not problems:
        sys.stdout.write("There is nothing to stop: no device here moves anything real.\n")
    if targets:
        sys.stdout.write(f"`rtagent rearm {' '.join(arguments.scenarios)}` lets it move again.\n")
    return 1 if not_safe or problems else 0


def rearm_command(arguments: argparse.Namespace) -> int:
    """Tell why hardware is latched and take the latches away; return 0, or 2 where devices cannot be known."""
    targets, problems = _targets(arguments)
    for hardware in {target.resort.hardware: None for target in targets}:
        entry = latched.find(hardware)
        if entry is not None:
            latched.release(hardware)
        sys.stdout.write(
            f"{entry}: it may move again.\n" if entry else f"{hardware or 'A fake'} was not latched.\n"
        )
    if not targets and not problems:
        sys.stdout.write("There is nothing to re-arm: no device here moves anything real.\n")
    return 2 if problems else 0


def _targets(arguments: argparse.Namespace) -> tuple[list[Target], bool]:
    """Return the guarded devices of all scenarios, and whether there was a problem, which was told."""
    targets, problems = list[Target](), list[str]()
    for scenario in arguments.scenarios:
        try:
            parts, found = load_devices(scenario, arguments.set)
        except ScenarioError as error:
            parts, found = [], error.problems
        problems += found
        for part in parts:
            targets += _target(part, str(Path(scenario).resolve()), problems)
    for problem in problems:
        sys.stderr.write(f"{problem}\n")
    return targets, bool(problems)


def _target(part: Part, scenario: str, problems: list[str]) -> Iterator[Target]:
    """Yield the device as a target if it is one, or note why that cannot be known."""
    name = str(part.path[-1])
    try:
        device = part.plugin(**part.given())
        if isinstance(device, Guarded):
            yield Target(name, scenario, device.last_resort(), safe_within(device) / second)
    except Exception as error:  # a plug-in may raise anything
        said = str(error) if isinstance(error, RtagentError) else repr(error)
        problems.append(f"{scenario}: devices.{name}: {said}")


@contextlib.contextmanager
def _told() -> Iterator[None]:
    """Tell of what fails, and go on: the hardware has to be made safe in any case."""
    try:
        yield
    except (OSError, RtagentError) as error:
        sys.stderr.write(f"{error}\n")


def _end_runs(scenarios: Iterable[str], targets: list[Target]) -> None:
    """Have the runs end that hold this hardware, or are of these scenarios; wait a moment for them."""
    paths = {str(Path(scenario).resolve()) for scenario in scenarios}
    hardware = {target.resort.hardware for target in targets} - {""}
    runs = [run for run in living.runs() if run.scenario in paths or hardware & set(run.hardware)]
    for run in runs:
        with contextlib.suppress(ProcessLookupError):
            os.kill(run.pid, signal.SIGTERM)
    for run in runs:
        ended = _has_ended(run.pid, max((target.within for target in targets), default=0.0) + A_MOMENT)
        said = "was stopped" if ended else "does not end: kill it"
        sys.stdout.write(f"The run of process {run.pid} ({run.scenario}) {said}.\n")


def _has_ended(pid: int, within: float) -> bool:
    """Say whether a process has ended within a time (s)."""
    try:
        process = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([process], [], [], within)[0])
    finally:
        os.close(process)


def _make_safe(targets: list[Target]) -> bool:
    """Make all targets safe by their last resorts, tell what is safe, and say whether something is not."""
    resorts = [Resort(target.name, target.resort.function, target.resort.settings) for target in targets]
    found = make_all_safe(resorts, max((target.within for target in targets), default=0.0) + A_MOMENT)
    for target, sentences in zip(targets, found, strict=True):
        for sentence in sentences or [f"device {target.name!r} is safe."]:
            sys.stdout.write(f"{sentence}\n")
    return any(found)
