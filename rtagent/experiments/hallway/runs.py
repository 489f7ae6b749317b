"""The runs of Hallway-World: which there are, and what is kept of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

from rtagent.experiments.experiment import Cell, Options, Row
from rtagent.experiments.scenarios import run_scenario
from rtagent.result import Result
from rtagent.schedule import FIXED

SCHEDULES = FIXED
DELAYS_MS = (0, 20, 50, 100)
SEEDS, QUICK_SEEDS, TOGETHER = 40, 10, 10
EPISODES, LATE = 40, 10
COSTS = {"observe": "1ms", "choose": "3us", "act": "1ms", "learn": "6us"}
EPSILON = 0.0
"""Greedy, as in Experiment 1: who explores at each of 500 choices a second hits walls all the time."""
OWN_SETTINGS = {
    "interruptible": ["learn.slice=1ms"],  # its own of 40 µs takes long to compute, and reacts 1 ms sooner
    "deferred": ['learn.urgent={ signal = "hallway.wall_left", below = 0.5 }'],
}
SAME_COST_MS = 10
"""What each component costs where all cost the same (the thesis's t_c)."""
SYNCHRONOUS, ASYNCHRONOUS, SAME_COSTS = "synchronous", "asynchronous", "same costs"


def cells(options: Options) -> Sequence[Cell]:
    """Return the runs of all schedules, in the world that waits and in the one that does not."""
    count = QUICK_SEEDS if options.quick else SEEDS
    parts = [list(range(first, first + TOGETHER)) for first in range(1, count + 1, TOGETHER)]
    return [cell for seeds in parts for cell in _cells(seeds)]


def _cells(seeds: list[int]) -> Iterator[Cell]:
    common = {"seeds": seeds, "episodes": EPISODES, "epsilon": EPSILON}
    for schedule in SCHEDULES:
        yield {"world": SYNCHRONOUS, "schedule": schedule, "costs": {}, "delay_ms": 0, **common}
    for schedule, delay in product(SCHEDULES, DELAYS_MS):
        yield {"world": ASYNCHRONOUS, "schedule": schedule, "costs": COSTS, "delay_ms": delay, **common}
    same = dict.fromkeys(("act", "observe", "choose", "learn"), f"{SAME_COST_MS}ms")
    for schedule in ("standard", "reactive"):
        yield {"world": SAME_COSTS, "schedule": schedule, "costs": same, "delay_ms": 0, **common}


def measure(cell: Cell) -> Row:
    """Run each seed of a cell under the virtual clock."""
    name = "hallway_synchronous" if cell["world"] == SYNCHRONOUS else "hallway"
    return {"runs": [_run(run_scenario(name, _settings(cell, seed)), seed) for seed in cell["seeds"]]}


def _settings(cell: Cell, seed: int) -> list[str]:
    costs = [f"costs.{component}={cost}" for component, cost in cell["costs"].items()]
    return [
        "run.clock=virtual",
        f"run.seed={seed}",
        f"run.episodes={cell['episodes']}",
        f"schedule.preset={cell['schedule']}",
        f"schedule.learn_delay={cell['delay_ms']}ms",
        f"policy.epsilon={cell['epsilon']}",
        *costs,
        *OWN_SETTINGS.get(cell["schedule"], ()),
    ]


def _run(result: Result, seed: int) -> Row:
    reactions = [reaction for episode in result.episodes for reaction in episode.reactions.reactions]
    return {
        "seed": seed,
        "returns": [episode.total_reward for episode in result.episodes],
        "deciding_ms": [reaction.deciding / 1e6 for reaction in reactions],
    }


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes: the more cycles, the longer."""
    many = cell["world"] == ASYNCHRONOUS and not cell["delay_ms"]
    return len(cell["seeds"]) * (0.6 if many else 0.07)
