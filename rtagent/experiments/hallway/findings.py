"""What Hallway-World showed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experiments import style
from rtagent.experiments.experiment import Cell, Claim, Figure, Findings, Options, Row, Table, Verdict
from rtagent.experiments.hallway.runs import ASYNCHRONOUS, LATE, SAME_COST_MS, SAME_COSTS, SYNCHRONOUS
from rtagent.experiments.statistics import Interval, above, all_of, below, interval, paired, within

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

STANDARD, REACTIVE = "standard", "reactive"
GREEDY_NOTE = (
    "All policies are greedy, as in Experiment 1. An agent that explores with some probability at each choice, and "
    "chooses hundreds of times a second, hits walls the more often the less its learning takes."
)
BLOCK = 4
"""So many episodes are a point of a learning curve."""
NEAR = 0.1
"""What is meant by a time: within this part of it."""

Group = tuple[str, str, float]
"""A world, a schedule, and what learning takes (ms)."""
Runs = Sequence[Mapping[str, Any]]
Groups = Mapping[Group, Runs]


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Compare the orders in both worlds, and draw how all schedules learn."""
    groups = _groups(pairs)
    made = (the_same_where_the_world_waits, worse_the_longer_it_takes, better_reactive, two_components_more)
    claims = tuple(claim for make in made for claim in make(groups))
    return Findings(claims, _figures(groups), (_table(groups),), (GREEDY_NOTE,))


def _groups(pairs: Sequence[tuple[Cell, Row]]) -> Groups:
    found: dict[Group, list[Mapping[str, Any]]] = defaultdict(list)
    for cell, row in pairs:
        found[cell["world"], cell["schedule"], cell["delay_ms"]] += row["runs"]
    return found


def the_same_where_the_world_waits(groups: Groups) -> Iterator[Claim]:
    """Claim: in a synchronous world both orders learn the same, and do as well."""
    ours, others = (
        np.array([run["returns"] for run in groups[SYNCHRONOUS, name, 0]]) for name in (REACTIVE, STANDARD)
    )
    equal = int(np.sum(ours == others))
    difference = paired(ours.mean(axis=1), others.mean(axis=1))
    undecided = Verdict.UNDECIDED if difference.low <= 0 <= difference.high else Verdict.NOT_REPRODUCED
    yield Claim(
        "In a synchronous Hallway-World both algorithms have the same policies and performance.",
        "the same",
        f"{equal} of {ours.size} episodes have the same return; the difference is {difference}",
        Verdict.REPRODUCED if equal == ours.size else undecided,
    )


def worse_the_longer_it_takes(groups: Groups) -> Iterator[Claim]:
    """Claim: performance decreases with the time that is spent on learning."""
    for schedule in (STANDARD, REACTIVE):
        over = delays(groups)
        change = paired(late(groups, schedule, over[-1]), late(groups, schedule, over[0]))
        means = ", ".join(f"{np.mean(late(groups, schedule, delay)):.3g}" for delay in over)
        yield Claim(
            f"Performance of {schedule} SARSA decreases with the time that the agent spends on learning.",
            "decreases",
            f"return of the last {LATE} episodes {means} at {_listed(over)} ms; from first to last {change}",
            below(change),
        )


def better_reactive(groups: Groups) -> Iterator[Claim]:
    """Claim: the reactive order comes closer to the optimal policy, which turns left at once."""
    over = [delay for delay in delays(groups) if delay > 0]
    found = {delay: paired(late(groups, REACTIVE, delay), late(groups, STANDARD, delay)) for delay in over}
    yield Claim(
        "SARSA cannot learn to turn left at once, because it learns between observing the opening and acting; "
        "Reactive SARSA acts first, and does better.",
        "better",
        "; ".join(f"return {each} higher at {delay:g} ms" for delay, each in found.items()),
        all_of(map(above, found.values())),
    )


def two_components_more(groups: Groups) -> Iterator[Claim]:
    """Claim: with components that take t_c each, choosing and learning stand between observing and acting.

    What is measured as deciding begins when observing begins.
    """
    found = {
        schedule: interval(
            [_median(run) - SAME_COST_MS for run in groups[SAME_COSTS, schedule, 0] if run["deciding_ms"]]
        )
        for schedule in (STANDARD, REACTIVE)
    }
    parts = {STANDARD: 2, REACTIVE: 1}
    yield Claim(
        "Where each component takes t_c, a SARSA agent acts 2 t_c after it has observed the opening.",
        "2 t_c (and t_c, for choosing, with Reactive SARSA)",
        "from the end of observing: " + "; ".join(f"{name} {_in_units(each)} t_c" for name, each in found.items()),
        all_of(within(_in_units(found[name]), number - NEAR, number + NEAR) for name, number in parts.items()),
    )


def delays(groups: Groups) -> list[float]:
    """Return what learning takes (ms) in the world that does not wait, sorted."""
    return sorted({delay for world, _, delay in groups if world == ASYNCHRONOUS})


def late(groups: Groups, schedule: str, delay: float) -> list[float]:
    """Return the mean return of the last episodes of each run."""
    return [float(np.mean(run["returns"][-LATE:])) for run in groups[ASYNCHRONOUS, schedule, delay]]


def _median(run: Mapping[str, Any]) -> float:
    return float(np.median(run["deciding_ms"]))


def _in_units(found: Interval) -> Interval:
    return Interval(found.low / SAME_COST_MS, found.middle / SAME_COST_MS, found.high / SAME_COST_MS)


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _figures(groups: Groups) -> tuple[Figure, ...]:
    agents = len(next(iter(groups.values())))
    run = f"Means of {agents} agents over {BLOCK} episodes each, with 95 % intervals of the mean (normal)."
    return (
        Figure(
            "asynchronous",
            f"Hallway-World goes on while the agent computes: what an episode costs. {run}",
            partial(_curves, groups, [(ASYNCHRONOUS, delay) for delay in delays(groups)]),
            (9.0, 3.2),
        ),
        Figure(
            "synchronous",
            f"Hallway-World waits for each action: what an episode costs. {run}",
            partial(_curves, groups, [(SYNCHRONOUS, 0)]),
        ),
    )


def _curves(groups: Groups, panels: Sequence[tuple[str, float]], canvas: Canvas) -> None:
    drawn: NDArray[Any] = canvas.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (world, delay) in zip(drawn, panels, strict=True):
        _panel(
            axes, {schedule: runs for (each, schedule, at), runs in groups.items() if (each, at) == (world, delay)}
        )
        axes.set_title(f"learning takes {delay:g} ms" if world == ASYNCHRONOUS else "", fontsize="medium")
        axes.set_xlabel("episode")
    drawn[0].set_ylabel("minus the return (s, and 1 for each wall)")
    drawn[0].set_yscale("log")  # the panels share it
    drawn[-1].legend(title="schedule", loc="upper right")


def _panel(axes: Axes, by_schedule: Mapping[str, Runs]) -> None:
    for number, (schedule, runs) in enumerate(by_schedule.items()):
        curves = -np.array([run["returns"] for run in runs])
        blocks = curves.reshape(len(curves), -1, BLOCK).mean(axis=2)
        middle, error = blocks.mean(axis=0), 1.96 * blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))
        ends = np.arange(BLOCK, curves.shape[1] + 1, BLOCK)
        style.series(
            axes, number, ends, middle, schedule, low=np.maximum(middle - error, middle / 10), high=middle + error
        )


def _table(groups: Groups) -> Table:
    head = ("schedule", *(f"{delay:g} ms" for delay in delays(groups)))
    names = list(dict.fromkeys(schedule for world, schedule, _ in groups if world == ASYNCHRONOUS))
    rows = tuple((name, *(str(interval(late(groups, name, delay))) for delay in delays(groups))) for name in names)
    return Table(
        f"Mean return of the last {LATE} episodes by what learning takes, with 95 % intervals.", head, rows
    )
