"""The trials of Experiment 1: which there are, and what is kept of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rtagent.experiments.experiment import Cell, Options, Row
from rtagent.experiments.scenarios import run_scenario
from rtagent.result import Result
from rtagent.schedule import PRESETS

SCHEDULES = tuple(PRESETS)
DELAYS_MS = (0, 50, 100, 250, 500)
TRIALS, QUICK_TRIALS = 30, 10
EPISODES, LATE = 20, 10
"""Of so many episodes, so many last ones count."""
COSTS = {"observe": "1ms", "choose": "10us", "act": "1ms"}
"""What the other components take: an exchange with a servo through a USB adapter about a millisecond."""

SLICED = ("interruptible", "background")
"""They do a thousand times as much in the same time: a look at the world after each slice, a cycle beside a thread."""

Trial = Mapping[str, Any]


def cells(options: Options) -> Sequence[Cell]:
    """Return each schedule with each delay, some trials to a cell; a trial of each has the same seed."""
    seeds = range(1, 1 + (QUICK_TRIALS if options.quick else TRIALS))
    return [
        {"schedule": schedule, "delay_ms": delay, "seeds": list(together), "episodes": EPISODES, "costs": COSTS}
        for schedule in SCHEDULES
        for delay in DELAYS_MS
        for together in _together(list(seeds), schedule, delay)
    ]


def _together(seeds: list[int], schedule: str, delay: float) -> list[list[int]]:
    """Return seeds in parts that are worth a process each: a schedule that does little has them all in one."""
    size = 1 if schedule in SLICED or not delay else len(seeds)
    return [seeds[first : first + size] for first in range(0, len(seeds), size)]


def measure(cell: Cell) -> Row:
    """Run the trials of a cell under the virtual clock."""
    return {"trials": [trial(run_scenario("stopping", _settings(cell, seed)), seed) for seed in cell["seeds"]]}


def _settings(cell: Cell, seed: int) -> list[str]:
    costs = [f"costs.{component}={cost}" for component, cost in cell["costs"].items()]
    return [
        "run.clock=virtual",
        f"run.seed={seed}",
        "run.trials=1",
        f"run.episodes={cell['episodes']}",
        f"schedule.preset={cell['schedule']}",
        f"schedule.learn_delay={cell['delay_ms']}ms",
        *costs,
    ]


def trial(result: Result, seed: int) -> Trial:
    """Return the summed reward of the last episodes of a trial, and its reactions and responses (s) in them."""
    late = result.episodes[-LATE:]
    return {
        "seed": seed,
        "reward": sum(episode.total_reward for episode in late),
        "reactions_s": [reaction.time / 1e9 for episode in late for reaction in episode.reactions.reactions],
        "responses_s": [time / 1e9 for episode in late for time in episode.reactions.responses],
        "missed": sum(episode.reactions.missed_responses for episode in late),
    }


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return 1.0 * len(cell["seeds"])
