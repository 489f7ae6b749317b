"""`rtagent replay`: a recording through the same agent again, or through another one."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rtagent.errors import RtagentError
from rtagent.learning import Verified
from rtagent.replay.mcap import read_recording
from rtagent.replay.replayer import Replayed, Replayer, manner
from rtagent.scenario import Assembly, assemble, load


def replay_command(arguments: argparse.Namespace) -> int:
    """Replay a recording; return 0, or 1 where what is unchanged came out otherwise, or 2 where it cannot be."""
    changed = bool(arguments.set)
    try:
        recorded = read_recording(Path(arguments.recording))
        assembly = _assembled(recorded.scenario, arguments.set)
        how = manner(assembly.schedule, changed=changed)
        plan = assembly.plan
        replayer = Replayer(assembly.task, assembly.make_agent, assembly.schedule, plan.limits, plan.seed, how)
        outcome = replayer.replay(recorded.events)
    except RtagentError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    told = _as_dict(outcome, changed=changed)
    if arguments.json:
        sys.stdout.write(json.dumps(told, indent=2) + "\n")
    else:
        sys.stdout.write("\n".join(_lines(outcome, changed=changed, followed=how.follows)) + "\n")
    return 0 if changed or outcome.same else 1


def _assembled(scenario: Mapping[str, Any], overrides: Sequence[str]) -> Assembly:
    """Return the parts of a recorded scenario, with what is set over it; no device is opened."""
    import tomli_w

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recorded.toml"
        path.write_text(tomli_w.dumps(scenario), encoding="utf-8")
        return assemble(load(path, overrides))


def _lines(outcome: Replayed, *, changed: bool, followed: bool) -> list[str]:
    lines = [
        f"replayed {outcome.observations:,} observations, {outcome.choices:,} choices, "
        f"{outcome.transitions:,} transitions learned"
    ]
    if outcome.choices and followed and not changed:
        lines.append("actions: those that were recorded, as learning was on a thread")
    elif outcome.choices:
        lines.append(_choices(outcome, changed=changed))
    if not changed:
        lines.append(_learned(outcome))
    if outcome.failure:
        lines.append(f"learning ended: {outcome.failure}")
    return lines + _predictions(outcome)


def _learned(outcome: Replayed) -> str:
    trials = "" if outcome.weights == 1 else f" of {outcome.weights} trials"
    if outcome.other_deltas or outcome.other_weights:
        return (
            f"learning: {outcome.other_deltas:,} of {outcome.deltas:,} errors are others than recorded, "
            f"and so are the final weights of {outcome.other_weights} of {outcome.weights} trials"
        )
    weights = f", and so are the final weights{trials}" if outcome.weights else ""
    return f"learning: all {outcome.deltas:,} errors are the recorded ones{weights}"


def _choices(outcome: Replayed, *, changed: bool) -> str:
    if not outcome.other_choices:
        return f"choices: all {outcome.choices:,} {'would be' if changed else 'are'} the recorded ones"
    verb = "would be" if changed else "are"
    trial, episode, time = outcome.differs or (0, 0, 0)
    return (
        f"choices: {outcome.other_choices:,} of {outcome.choices:,} {verb} others, "
        f"the first in episode {episode + 1} of trial {trial + 1}, at {time} ns"
    )


def _predictions(outcome: Replayed) -> list[str]:
    return [
        f"{name}: mean error {error['mae']:.4g}, rms error {error['rmse']:.4g}"
        for errors in _errors(outcome)[-1:]
        for name, error in errors.items()
        if error["verified"]
    ]


def _errors(outcome: Replayed) -> list[dict[str, dict[str, Any]]]:
    learners = [agent.learner for agent in outcome.agents]
    return [
        {name: asdict(errors) for name, errors in learner.errors().items()} if isinstance(learner, Verified) else {}
        for learner in learners
    ]


def _as_dict(outcome: Replayed, *, changed: bool) -> dict[str, Any]:
    return {
        "changed": changed,
        "observations": outcome.observations,
        "choices": outcome.choices,
        "other_choices": outcome.other_choices,
        "first_other_choice_ns": outcome.differs[2] if outcome.differs else None,
        "transitions": outcome.transitions,
        "errors_compared": outcome.deltas,
        "other_errors": outcome.other_deltas,
        "weights_compared": outcome.weights,
        "other_weights": outcome.other_weights,
        "returns": outcome.returns,
        "failure": outcome.failure,
        "predictions": _errors(outcome),
    }
