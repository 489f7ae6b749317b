"""The trials of Experiment 1: which there are, and what is kept of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rtagent.experiments.experiment import Cell, Options, Row
from rtagent.experiments.scenarios import run_scenario
from rtagent.result import Result
from rtagent.schedule import FIXED

SCHEDULES = FIXED
DELAYS_MS = (0, 50, 100, 250, 500)
THESIS = ("standard", "reactive")
TRIALS, QUICK_TRIALS, QUICK_TRIALS_OF_OURS = 30, 10, 2
"""The quick form has all of the thesis's trials where they are short: where there is a delay."""
EPISODES, LATE = 20, 10
"""Of so many episodes, so many last ones count."""
COSTS = {"observe": "1ms", "choose": "3us", "act": "1ms", "learn": "6us"}
"""What components take beside the delay: an exchange with a servo, through a USB adapter, about a millisecond;
choosing and learning what they took under the real clock, in the median."""
LITERAL_UNIT, LITERAL_DELAY_MS = "1us", 50
"""The thesis prints that rewards count microseconds: a few trials take that literally."""
TOGETHER = 10
"""So many trials are a cell, where they are short."""

Trial = Mapping[str, Any]


def cells(options: Options) -> Sequence[Cell]:
    """Return each schedule with each delay, some trials to a cell; a trial of each has the same seed."""
    common = {"episodes": EPISODES, "costs": COSTS}
    compared = [
        {"schedule": schedule, "delay_ms": delay, "seeds": seeds, **common}
        for schedule in SCHEDULES
        for delay in DELAYS_MS
        for seeds in _together(_trials(schedule, delay, options.quick), schedule, delay)
    ]
    first = list(range(1, 1 + QUICK_TRIALS))
    literal = {"delay_ms": LITERAL_DELAY_MS, "reward_unit": LITERAL_UNIT, "seeds": first, **common}
    return [*compared, *({"schedule": schedule, **literal} for schedule in THESIS)]


def _trials(schedule: str, delay: float, quick: bool) -> int:
    if not quick or (schedule in THESIS and delay):
        return TRIALS
    return QUICK_TRIALS if schedule in THESIS else QUICK_TRIALS_OF_OURS


def _together(trials: int, schedule: str, delay: float) -> list[list[int]]:
    """Return the seeds of the trials, in parts that are worth a process each."""
    size = 1 if _trial_seconds(schedule, delay) > 1 else TOGETHER
    return [list(range(first, min(first + size, trials + 1))) for first in range(1, trials + 1, size)]


def measure(cell: Cell) -> Row:
    """Run the trials of a cell under the virtual clock."""
    return {"trials": [trial(run_scenario("stopping", _settings(cell, seed)), seed) for seed in cell["seeds"]]}


def _settings(cell: Cell, seed: int) -> list[str]:
    costs = [f"costs.{component}={cost}" for component, cost in cell["costs"].items()]
    unit = [f"devices.joint.reward_unit={cell['reward_unit']}"] if "reward_unit" in cell else []
    return [
        "run.clock=virtual",
        f"run.seed={seed}",
        "run.trials=1",
        f"run.episodes={cell['episodes']}",
        f"schedule.preset={cell['schedule']}",
        f"schedule.learn_delay={cell['delay_ms']}ms",
        *costs,
        *unit,
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
        "anticipated": sum(episode.reactions.anticipated for episode in late),
    }


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return len(cell["seeds"]) * _trial_seconds(cell["schedule"], cell["delay_ms"])


def _trial_seconds(schedule: str, delay_ms: float) -> float:
    """Return how long a trial takes: many short cycles, or many slices, take long to compute."""
    if not delay_ms:
        return 0.9
    return 4.5 + 0.01 * delay_ms if schedule == "interruptible" else 0.08
