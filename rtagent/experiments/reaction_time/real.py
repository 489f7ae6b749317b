"""Experiment 1 under the real clock: with a simulated delay, and with a Horde that really learns in its place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from rtagent.experiments.experiment import Cell, Claim, Experiment, Findings, Options, Row, Table, Verdict
from rtagent.experiments.reaction_time import findings
from rtagent.experiments.reaction_time.figures import figures
from rtagent.experiments.reaction_time.groups import groups_of
from rtagent.experiments.reaction_time.tables import table
from rtagent.experiments.reaction_time.trials import DELAYS_MS, EPISODES, LATE, SCHEDULES, trial
from rtagent.experiments.scenarios import run_scenario
from rtagent.experiments.statistics import interval, within
from rtagent.result import Result

SEEDS, QUICK_SEEDS = (1, 2, 3, 4, 5), (1, 2, 3)
QUICK_EPISODES, QUICK_SCHEDULES = LATE + 2, ("standard", "reactive", "interruptible")
EPISODE_SECONDS = 1.05
"""How long an episode takes beside the reaction: Emergency comes after 0.5 to 1.5 s."""

BINS = {133: 15_008, 267: 30_016, 669: 75_040, 1338: 149_968}
"""How finely each signal of the arm is predicted, and how many demons that makes: in the thesis 50 to 500 ms."""
THESIS_MICROSECONDS = (2.8, 3.9)
"""About 3.33 µs a demon."""

SHORT_NOTE = (
    "Where a step of learning takes less than what the operating system does beside, the order of the components "
    "cannot be told from reactions: claims about parts of a step are not asked here."
)

MODELS = (
    "The joint is a fake that is read as of now; the clock, the processor and what the operating system does to "
    "both are real. Another program on this machine disturbs what is measured.",
)


def delay_cells(options: Options) -> Sequence[Cell]:
    """Return each schedule with each delay, a trial to a cell."""
    delays = (0, 50) if options.quick else DELAYS_MS
    return [{**common, "delay_ms": delay} for delay in delays for common in _common(options)]


def horde_cells(options: Options) -> Sequence[Cell]:
    """Return each schedule with each number of demons, a trial to a cell."""
    chosen = (133, 1338) if options.quick else tuple(BINS)
    schedules = QUICK_SCHEDULES
    return [
        {**common, "bins": bins, "demons": BINS[bins]}
        for bins in chosen
        for common in _common(options)
        if common["schedule"] in schedules
    ]


def _common(options: Options) -> Iterator[Cell]:
    schedules, seeds = (QUICK_SCHEDULES, QUICK_SEEDS) if options.quick else (SCHEDULES, SEEDS)
    for schedule, seed in product(schedules, seeds):
        episodes = QUICK_EPISODES if options.quick else EPISODES
        yield {"schedule": schedule, "seeds": [seed], "episodes": episodes}


def measure_delay(cell: Cell) -> Row:
    """Run a trial with a simulated delay."""
    delay = f"schedule.learn_delay={cell['delay_ms']}ms"
    return {"trials": [trial(_run("stopping", cell, seed, delay), seed) for seed in cell["seeds"]]}


def measure_horde(cell: Cell) -> Row:
    """Run a trial beside a Horde; keep how long (ms) a step of learning took, where it is in one piece."""
    bins = f"horde.demons.0.bins={cell['bins']}"
    results = {seed: _run("stopping_horde", cell, seed, bins) for seed in cell["seeds"]}
    learning = [result.components()["learn"].median / 1e6 for result in results.values() if _in_one_piece(cell)]
    return {"trials": [trial(result, seed) for seed, result in results.items()], "learning_ms": learning}


def _in_one_piece(cell: Cell) -> bool:
    return cell["schedule"] in ("standard", "reactive")


def _run(name: str, cell: Cell, seed: int, load: str) -> Result:
    plan = ["run.clock=real", f"run.seed={seed}", "run.trials=1", f"run.episodes={cell['episodes']}"]
    return run_scenario(name, [*plan, f"schedule.preset={cell['schedule']}", load])


def find_horde(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Compare the schedules, with what a step of learning really took in place of the delay."""
    took = {demons: _learning(pairs, demons) for demons in dict.fromkeys(cell["demons"] for cell, _ in pairs)}
    known = {demons: round(float(np.median(times)), 3) for demons, times in took.items()}
    measured = [({**cell, "delay_ms": known[cell["demons"]]}, row) for cell, row in pairs]
    groups = groups_of(measured)
    return Findings(
        (_each_demon(took), *findings.quicker(groups), *findings.flat(groups)),
        figures(groups, measured),
        (_demons(took), table(groups)),
        (findings.DEMONS_NOTE, SHORT_NOTE),
    )


def _learning(pairs: Sequence[tuple[Cell, Row]], demons: int) -> list[float]:
    """Return what a step of learning took (ms) in each trial with so many demons."""
    return [time for cell, row in pairs if cell["demons"] == demons for time in row["learning_ms"]]


def _each_demon(took: dict[int, list[float]]) -> Claim:
    each = interval([1e3 * time / demons for demons, times in took.items() for time in times], np.median)
    verdict = within(each, *THESIS_MICROSECONDS)
    differs = verdict is Verdict.NOT_REPRODUCED
    return Claim(
        "A demon's prediction takes about 3.33 µs.",
        "3.33 µs",
        f"{each} µs",
        Verdict.DIFFERS if differs else verdict,
        "It is a figure of the machine, and of how the demons are computed: here those of a group share a trace."
        * differs,
    )


def _demons(took: dict[int, list[float]]) -> Table:
    rows = tuple((f"{demons:,}", str(interval(times, np.median))) for demons, times in took.items())
    return Table("What a step of learning took.", ("demons", "ms"), rows)


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes: it is real time."""
    return float(
        cell["episodes"] * (EPISODE_SECONDS + 1.5e-3 * cell.get("delay_ms", 0)) + 3e-5 * cell.get("demons", 0)
    )


REAL = Experiment(
    name="reaction-time-real",
    title="Experiment 1 under the real clock",
    thesis="Section 3.4.1, figure 3.4",
    cells=delay_cells,
    measure=measure_delay,
    find=findings.find,
    seconds=seconds,
    models=MODELS,
    alone=True,
    on_demand=True,
)

HORDE = Experiment(
    name="reaction-time-horde",
    title="Experiment 1 with 15,000 to 150,000 demons in place of the simulated delay",
    thesis="Section 3.4.1",
    cells=horde_cells,
    measure=measure_horde,
    find=find_horde,
    seconds=seconds,
    models=MODELS,
    alone=True,
    on_demand=True,
)
