"""What the experiments of chapter 3 find follows from their rows: turned round, so are the verdicts."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

import numpy as np
import pytest

from rtagent.experiments import cartpole, hallway, reaction_time
from rtagent.experiments.experiment import Experiment, Findings, Options, Verdict
from rtagent.experiments.hallway.runs import ASYNCHRONOUS, SAME_COSTS, SYNCHRONOUS
from rtagent.experiments.outcome import canvas_of
from rtagent.experiments.reaction_time import real

REPRODUCED, NOT, UNDECIDED = Verdict.REPRODUCED, Verdict.NOT_REPRODUCED, Verdict.UNDECIDED
REACTION_TIME, HALLWAY = reaction_time.EXPERIMENT, hallway.EXPERIMENT
Pairs = list[tuple[Mapping[str, Any], Mapping[str, Any]]]
SEEDS = 20


def verdicts(experiment: Experiment, pairs: Pairs) -> list[Verdict]:
    return [claim.verdict for claim in experiment.find(pairs, Options()).claims]


def stopping(react: Callable[[str, float, np.random.Generator], float]) -> Pairs:
    """Return rows of trials with ten reactions (s) each, and rewards that are minus their sum."""
    pairs: Pairs = []
    for schedule in reaction_time.trials.SCHEDULES:
        for delay in (0, 50, 100, 250, 500):
            trials = []
            for seed in range(SEEDS):
                rng = np.random.default_rng([seed, delay])
                times = [react(schedule, delay / 1000, rng) for _ in range(10)]
                trials.append({"seed": seed, "reward": -sum(times), "reactions_s": times, "missed": 0})
            cell = {"schedule": schedule, "delay_ms": delay, "seeds": [], "episodes": 20, "costs": {}}
            pairs.append((cell, {"trials": trials}))
    return pairs


def as_the_thesis_says(schedule: str, delay: float, rng: np.random.Generator) -> float:
    """Half the delay, or one delay more that comes with spread; what can be interrupted waits for nothing."""
    within, further = rng.uniform(0, 1), rng.uniform(0.6, 1.4)
    if schedule in ("interruptible", "background"):
        return 0.001
    return 0.001 + within * delay + (further * delay + 0.0001 if schedule == "standard" else 0.0)


def test_reactions_as_the_thesis_says_reproduce_all_of_it() -> None:
    assert verdicts(REACTION_TIME, stopping(as_the_thesis_says)) == [REPRODUCED] * 8


def test_reactions_the_other_way_round_reproduce_nothing_but_that_delays_cost_reward() -> None:
    other = {"standard": "reactive", "reactive": "standard", "interruptible": "standard"}
    turned = stopping(lambda schedule, delay, rng: as_the_thesis_says(other.get(schedule, schedule), delay, rng))
    assert verdicts(REACTION_TIME, turned) == [NOT, NOT, NOT, REPRODUCED, REPRODUCED, NOT, NOT, NOT]


def test_reactions_that_do_not_depend_on_anything_reproduce_nothing_but_that_interruption_helps() -> None:
    found = verdicts(REACTION_TIME, stopping(lambda schedule, delay, rng: rng.uniform(0.1, 0.11)))
    assert found[:3] == [NOT, NOT, NOT]
    assert set(found[3:5]) <= {NOT, UNDECIDED}
    assert found[7] == REPRODUCED


def test_trials_without_a_reaction_are_left_out_of_what_is_said_of_reactions() -> None:
    pairs = stopping(as_the_thesis_says)
    for _, row in pairs:
        row["trials"][3]["reactions_s"] = []
    assert verdicts(REACTION_TIME, pairs) == [REPRODUCED] * 8


def walking(returns: Callable[[str, str, float, int], float], deciding: Mapping[str, float]) -> Pairs:
    pairs: Pairs = []
    worlds = [(SYNCHRONOUS, (0,)), (ASYNCHRONOUS, (0, 20, 50, 100)), (SAME_COSTS, (0,))]
    for world, delays in worlds:
        for schedule in ("standard", "reactive"):
            for delay in delays:
                runs = [
                    {"seed": seed, "returns": [returns(world, schedule, delay, seed)] * 40, "deciding_ms": []}
                    for seed in range(SEEDS)
                ]
                for run in runs:
                    run["deciding_ms"] = [deciding[schedule]] * 3
                pairs.append(({"world": world, "schedule": schedule, "delay_ms": delay}, {"runs": runs}))
    return pairs


def slower(world: str, schedule: str, delay: float, seed: int) -> float:
    """Return what falls with the delay, twice as quickly for the standard order, but for the world that waits."""
    if world == SYNCHRONOUS:
        return -0.5 - 0.01 * seed
    return -0.5 - 0.01 * seed - (0.02 if schedule == "standard" else 0.01) * delay


def test_a_hallway_as_the_thesis_says_reproduces_all_of_it() -> None:
    assert verdicts(HALLWAY, walking(slower, {"standard": 30.0, "reactive": 20.0})) == [REPRODUCED] * 5


def test_a_hallway_turned_round_reproduces_nothing() -> None:
    def turned(world: str, schedule: str, delay: float, seed: int) -> float:
        if world == SYNCHRONOUS:
            return -0.5 - (0.1 if schedule == "standard" else 0.0)
        return -slower(world, schedule, delay, seed)

    assert verdicts(HALLWAY, walking(turned, {"standard": 20.0, "reactive": 30.0})) == [NOT] * 5


def test_a_hallway_that_differs_by_chance_leaves_the_question_open() -> None:
    def noisy(world: str, schedule: str, delay: float, seed: int) -> float:
        return float(np.random.default_rng([seed, len(world), *schedule.encode(), int(delay)]).normal())

    found = verdicts(HALLWAY, walking(noisy, {"standard": 30.0, "reactive": 20.0}))
    assert found[0] == UNDECIDED
    assert REPRODUCED not in found[:4]


def beside_hordes(each_demon_us: float, later_ms: Mapping[str, float]) -> Pairs:
    """Return rows in which a step of learning takes so long for each demon, and a schedule reacts so much later."""
    pairs: Pairs = []
    for (bins, demons), schedule, seed in product(real.BINS.items(), real.QUICK_SCHEDULES, range(5)):
        step = demons * each_demon_us / 1000
        times = [(0.1 + 0.01 * seed + later_ms[schedule] * step) / 1000] * 10
        trial = {"seed": seed, "reward": -sum(times), "reactions_s": times, "missed": 0}
        cell = {"schedule": schedule, "bins": bins, "demons": demons, "seeds": [seed], "episodes": 20}
        learning = [step * (1 + 0.01 * seed)] if schedule != "interruptible" else []
        pairs.append((cell, {"trials": [trial], "learning_ms": learning}))
    return pairs


@pytest.mark.parametrize(
    ("each_demon_us", "later_ms", "expected"),
    [
        (3.33, {"standard": 1.5, "reactive": 0.5, "interruptible": 0.0}, [REPRODUCED] * 3),
        (0.01, {"standard": 0.5, "reactive": 1.5, "interruptible": 1.0}, [Verdict.DIFFERS, NOT, NOT]),
    ],
)
def test_what_is_found_beside_hordes_follows_from_what_learning_took(
    each_demon_us: float, later_ms: Mapping[str, float], expected: list[Verdict]
) -> None:
    assert verdicts(real.HORDE, beside_hordes(each_demon_us, later_ms)) == expected


@pytest.mark.parametrize(("slope", "expected"), [(-5.0, [REPRODUCED, REPRODUCED]), (5.0, [NOT, NOT])])
def test_cartpole_is_better_or_worse_as_its_returns_are(slope: float, expected: list[Verdict]) -> None:
    pairs: Pairs = []
    for cell in cartpole.cells(Options()):
        steeper = 2 if cell["schedule"] == "standard" else 1
        returns = np.random.default_rng(cell["delay_ms"]).normal(
            300 + steeper * slope * cell["delay_ms"], 5, (10, 60)
        )
        pairs.append((cell, {"returns": returns.tolist()}))
    assert verdicts(cartpole.EXPERIMENT, pairs) == expected


@pytest.mark.parametrize("experiment", [REACTION_TIME, HALLWAY], ids=lambda each: each.name)
def test_the_cells_of_the_quick_form_are_fewer_and_of_the_same_kinds(experiment: Experiment) -> None:
    quick, full = experiment.cells(Options(quick=True)), experiment.cells(Options())
    work = [sum(map(experiment.seconds, cells)) for cells in (quick, full)]
    assert work[0] < 120 < work[1]
    for key in ("schedule", "delay_ms"):
        assert {cell[key] for cell in quick} == {cell[key] for cell in full}


def small(experiment: Experiment) -> Findings:
    """Measure one seed of each cell, in few episodes, and find."""
    cells = [{**cell, "seeds": [1, 2], "episodes": 12} for cell in experiment.cells(Options(quick=True))]
    shorter = list({str(cell): cell for cell in cells if keeps(cell)}.values())
    return experiment.find([(cell, experiment.measure(cell)) for cell in shorter], Options(quick=True))


def keeps(cell: Mapping[str, Any]) -> bool:
    """Leave out the schedules that take long to compute."""
    return cell["schedule"] in ("standard", "reactive")


@pytest.mark.slow
@pytest.mark.parametrize("experiment", [REACTION_TIME, HALLWAY], ids=lambda each: each.name)
def test_what_is_measured_can_be_found_and_drawn(experiment: Experiment) -> None:
    findings = small(experiment)
    assert len(findings.claims) >= 5
    for figure in findings.figures:
        picture = io.BytesIO()
        canvas_of(figure).savefig(picture, format="svg")
        assert all(axes.get_xlabel() for axes in canvas_of(figure).axes)
        assert len(picture.getvalue()) > 5000
