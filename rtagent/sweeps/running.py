"""Measures a run of a sweep: from a resolved scenario to a row of its results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tomli_w

from rtagent.realtime import manners
from rtagent.result import Result, RunError
from rtagent.runtime import Habits
from rtagent.scenario import assemble, load
from rtagent.summary import Summary

DONE = "done"
LATE = 10
"""The returns of so many last episodes have a mean of their own, as in the thesis."""


def measure_run(cell: Mapping[str, Any]) -> Mapping[str, Any]:
    """Run the resolved scenario in `cell` and return its row; a run that ended early says why, in `ended`."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.toml"
        path.write_text(tomli_w.dumps(cell["scenario"]), encoding="utf-8")
        scenario = load(path)
    assembly = assemble(scenario)
    with manners(assembly.realtime, scenario.model.run.clock, busy=assembly.never_sleeps) as granted:
        try:
            result = granted.run(assembly.run(habits=Habits(granted.calm, granted.place_learner)))
        except RunError as error:
            if error.stopped:
                raise
            return {"ended": str(error), **row(error.result)}
    return {"ended": DONE if result.learned_all else "not all was learned", **row(result)}


def row(result: Result) -> dict[str, Any]:
    """Return what a run came to as one flat row; times are in seconds, what there is none of is None."""
    episodes = [episode for episode in result.episodes if episode.finished]
    returns = [episode.total_reward for episode in episodes]
    return {
        "episodes": len(episodes),
        "steps": sum(episode.steps for episode in episodes),
        "duration_s": result.recorder.elapsed / 1e9,
        "return_mean": _mean(returns),
        f"return_last_{LATE}": _mean(returns[-LATE:]),
        "returns": returns,
        **_times("reaction", result.reaction_time),
        **_times("response", result.response_time),
        "anticipated": result.anticipated,
        "learning_share": result.learning().share,
        **_errors(result),
    }


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _times(name: str, summary: Summary) -> dict[str, Any]:
    times = {key: value if summary.count or key == "count" else None for key, value in summary.in_seconds().items()}
    return {f"{name}_{key}": value for key, value in times.items()} | {f"{name}_missed": summary.missed}


def _errors(result: Result) -> dict[str, float | None]:
    """Return the errors of predictions, of the last trial's agent, by the names of its demons."""
    found = result.predictions(len(result.agents) - 1) if result.agents else {}
    return {f"rmse {name}": errors.rmse for name, errors in found.items()}
