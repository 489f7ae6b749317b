"""Beyond the thesis: CartPole, which does not wait either, under all schedules and several costs of learning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rtagent.experiments import style
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Table
from rtagent.experiments.scenarios import run_scenario
from rtagent.experiments.statistics import above, all_of, below, interval, paired
from rtagent.schedule import FIXED

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

DELAYS_MS, STEP_MS = (0, 15, 30, 60), 20
TRIALS, EPISODES, QUICK_EPISODES, BLOCK = 10, 60, 32, 4
COSTS = {"observe": "10us", "choose": "7us", "act": "3us"}
"""As they are under the real clock."""
SLICES = {"interruptible": ["learn.slice=1ms"]}
"""With the schedule's own of 40 µs it is computed ten times as slowly; a step of the world is 20 ms."""

Returns = NDArray[np.float64]
Groups = Mapping[tuple[str, int], Returns]
"""The return of each episode (shape: trials, episodes), by schedule and delay (ms)."""


def cells(options: Options) -> Sequence[Cell]:
    """Return each schedule with each delay, all its trials together."""
    plan = {"seed": 1, "trials": TRIALS, "episodes": QUICK_EPISODES if options.quick else EPISODES}
    return [{"schedule": name, "delay_ms": delay, **plan} for delay, name in product(DELAYS_MS, FIXED)]


def measure(cell: Cell) -> Row:
    """Run the trials of a cell under the virtual clock."""
    costs = [f"costs.{component}={cost}" for component, cost in COSTS.items()]
    plan = [f"run.{name}={cell[name]}" for name in ("seed", "trials", "episodes")]
    rules = [f"schedule.preset={cell['schedule']}", f"schedule.learn_delay={cell['delay_ms']}ms"]
    settings = ["run.clock=virtual", *plan, *rules, *costs, *SLICES.get(cell["schedule"], ())]
    returns = [episode.total_reward for episode in run_scenario("cartpole", settings).episodes]
    return {"returns": np.reshape(returns, (cell["trials"], cell["episodes"])).tolist()}


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Compare what is late with what is not."""
    groups = {(cell["schedule"], cell["delay_ms"]): np.array(row["returns"]) for cell, row in pairs}
    run = f"{pairs[0][0]['trials']} agents, {pairs[0][0]['episodes']} episodes of at most 500 steps; virtual clock"
    figure = Figure(
        "curves",
        f"CartPole that does not wait: steps of {STEP_MS} ms balanced, by episode, in means of {BLOCK} episodes; "
        f"bands: one standard error. {run}.",
        partial(_draw, groups),
        (9.0, 2.8),
    )
    return Findings((_worse(groups), _better(groups)), (figure,), (_table(groups),))


def late(groups: Groups, schedule: str, delay: int) -> list[float]:
    """Return the mean of the last fifth of the episodes, for each trial."""
    returns = groups[schedule, delay]
    return list(returns[:, -returns.shape[1] // 5 :].mean(axis=1))


def _worse(groups: Groups) -> Claim:
    lost = {
        name: paired(late(groups, name, DELAYS_MS[-1]), late(groups, name, 0)) for name in ("standard", "reactive")
    }
    return Claim(
        "As the time between observing and acting grows, performance deteriorates, whatever the source of "
        "the delay (3.5).",
        "deteriorates",
        "; ".join(f"{name}: {each} steps from 0 to {DELAYS_MS[-1]} ms" for name, each in lost.items()),
        all_of(map(below, lost.values())),
    )


def _better(groups: Groups) -> Claim:
    over = [delay for delay in DELAYS_MS if delay > STEP_MS]
    gained = {delay: paired(late(groups, "reactive", delay), late(groups, "standard", delay)) for delay in over}
    return Claim(
        "A reactive agent can perform better, the more so the longer learning takes (3.5).",
        "better",
        "; ".join(f"{each} steps more at {delay} ms" for delay, each in gained.items()),
        all_of(map(above, gained.values())),
    )


def _table(groups: Groups) -> Table:
    head = ("schedule", *(f"{delay} ms" for delay in DELAYS_MS))
    rows = tuple((name, *(str(interval(late(groups, name, delay))) for delay in DELAYS_MS)) for name in FIXED)
    return Table("Steps balanced in the last fifth of the episodes, with 95 % intervals.", head, rows)


def _draw(groups: Groups, canvas: Canvas) -> None:
    panels = canvas.subplots(1, len(DELAYS_MS), sharey=True)
    for axes, delay in zip(panels, DELAYS_MS, strict=True):
        for number, name in enumerate(FIXED):
            ends, mean, error = _curve(groups[name, delay])
            style.series(axes, number, ends, mean, name, low=mean - error, high=mean + error, markevery=3)
        axes.set_title(f"learning takes {delay} ms", fontsize="medium")
        axes.set_xlabel("episode")
    panels[0].set_ylabel(f"steps of {STEP_MS} ms balanced")
    panels[-1].legend(title="schedule", loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _curve(returns: Returns) -> tuple[Returns, Returns, Returns]:
    """Return the last episode of each block, its mean, and the standard error of that."""
    blocks = returns.reshape(len(returns), -1, BLOCK).mean(axis=2)
    ends = np.arange(BLOCK, returns.shape[1] + 1, BLOCK, dtype=float)
    return ends, blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes."""
    return 0.25 * float(cell["episodes"])


EXPERIMENT = Experiment(
    name="cartpole",
    title="Beyond the thesis: CartPole that does not wait (needs gymnasium)",
    thesis="Section 3.5",
    cells=cells,
    measure=measure,
    find=find,
    seconds=seconds,
    models=("CartPole is Gymnasium's; an action counts for the whole of the step of 20 ms in which it comes.",),
    on_demand=True,
)
