"""What learned ordering finds follows from its rows: turned round, so are the verdicts; and what a run keeps."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from rtagent.experience import Observation, Sample
from rtagent.experiments.experiment import Options, Verdict
from rtagent.experiments.learned_ordering import EXPERIMENT
from rtagent.experiments.learned_ordering.runs import (
    FORETOLD,
    LEARNED,
    PARTS,
    RANDOM,
    SCHEDULES,
    WORLDS,
    Ledger,
    measure,
    settings,
)
from rtagent.experiments.outcome import canvas_of
from rtagent.experiments.scenarios import scenario
from rtagent.learn import Where
from rtagent.recorder import EpisodeRecord
from rtagent.scenario import assemble, load
from rtagent.schedule import ACT, FIXED, OBSERVE
from rtagent.units import ms, second

REPRODUCED, NOT, UNDECIDED = Verdict.REPRODUCED, Verdict.NOT_REPRODUCED, Verdict.UNDECIDED
Pairs = list[tuple[Mapping[str, Any], Mapping[str, Any]]]
SEEDS = 12
CLAIMS = 6
"""So many for each world."""


def rows(earns: Callable[[str, int, int], float], learning: tuple[float, float] = (0.6, 0.2)) -> Pairs:
    """Return rows that are shuffled: `earns` says what a schedule earns with a seed, in a part of the run."""
    calm, urgent = learning
    pairs: Pairs = [
        (
            {"world": world, "schedule": name, "seed": seed, "length": 60},
            {
                "earned": [earns(name, seed, part) for part in range(PARTS)],
                "reaction_ms": [1.0, 2.0, 3.0],
                "missed": 0,
                "learned": 10,
                "shares": {"calm": {"learn": calm + seed / 1000}, "urgent": {"learn": urgent}},
            },
        )
        for world in WORLDS
        for name in SCHEDULES
        for seed in range(SEEDS)
    ]
    return [pairs[place] for place in np.random.default_rng(0).permutation(len(pairs))]


def verdicts(pairs: Pairs) -> list[Verdict]:
    return [claim.verdict for claim in EXPERIMENT.find(pairs, Options()).claims]


def noise(seed: int, name: str = "") -> float:
    """Return what a world has in store, and a little that is a schedule's own."""
    return 10 * np.sin(seed) + 0.1 * np.sin(100 * seed + len(name))


def test_more_than_all_others_with_every_seed_is_more() -> None:
    more = rows(lambda name, seed, part: noise(seed, name) + (name == LEARNED))
    assert verdicts(more) == [REPRODUCED] * CLAIMS * len(WORLDS)


def test_less_is_not_more() -> None:
    less = rows(lambda name, seed, part: noise(seed, name) - (name == LEARNED), (0.2, 0.6))
    assert verdicts(less) == [NOT] * CLAIMS * len(WORLDS)


def test_what_differs_with_the_seed_alone_is_undecided() -> None:
    same = rows(lambda name, seed, part: noise(seed, name))
    assert set(verdicts(same)[: CLAIMS - 1]) == {UNDECIDED}


def test_one_preset_that_does_better_is_enough() -> None:
    found = verdicts(rows(lambda name, seed, part: {LEARNED: 1.0, "deferred": 2.0}.get(name, 0.0) + noise(seed)))
    assert found[:CLAIMS] == [NOT, NOT, REPRODUCED, REPRODUCED, REPRODUCED, REPRODUCED]


def test_what_is_learned_late_counts_in_the_second_half_alone() -> None:
    late = rows(lambda name, seed, part: noise(seed) + (name == LEARNED) * (1.0 if part >= PARTS // 2 else -2.0))
    assert verdicts(late)[:2] == [NOT, REPRODUCED]


@pytest.mark.slow
def test_its_figures_are_drawn_and_its_tables_name_every_schedule() -> None:
    found = EXPERIMENT.find(rows(lambda name, seed, part: noise(seed, name)), Options())
    for figure in found.figures:
        canvas_of(figure).savefig(io.BytesIO())
    assert all([row[0] for row in table.rows] == list(SCHEDULES) for table in found.tables)


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", SCHEDULES)
def test_each_cell_is_a_scenario_that_can_be_run(world: str, name: str) -> None:
    cell = {"world": world, "schedule": name, "seed": 3, "length": 20}
    assembly = assemble(load(scenario(world), settings(cell)))
    expected = "learned" if name in (LEARNED, RANDOM) else "deferred" if name == FORETOLD else name
    assert assembly.schedule.name == expected
    assert (assembly.schedule.learn.urgent is not None) == (name == FORETOLD)


def test_its_cells_pair_the_same_seeds_of_all_schedules() -> None:
    for quick in (False, True):
        cells = EXPERIMENT.cells(Options(quick=quick))
        seeds = {
            (world, name): [cell["seed"] for cell in cells if (cell["world"], cell["schedule"]) == (world, name)]
            for world in WORLDS
            for name in SCHEDULES
        }
        assert len({tuple(each) for each in seeds.values()}) == 1
        assert {*FIXED, LEARNED} <= {name for _, name in seeds}


def test_a_cell_is_measured_the_same_again() -> None:
    cell = {"world": "phases_stopping", "schedule": LEARNED, "seed": 2, "length": PARTS}
    row = measure(cell)
    assert row == measure(cell)
    assert len(row["earned"]) == PARTS
    assert row["reaction_ms"] == sorted(row["reaction_ms"])
    assert set(row["shares"]) == {"calm", "urgent"}
    assert all(sum(parts.values()) == pytest.approx(1.0, abs=0.05) for parts in row["shares"].values())


def observed(ledger: Ledger, time: int, busy: bool, reward: float) -> None:
    sample = Sample({"busy": busy, "reward": reward}, time, time, time)
    ledger.observed(Observation(time, {"board": sample}), ())


def test_the_ledger_tells_what_was_earned_and_where_the_time_went_by_hand() -> None:
    ledger = Ledger("busy", 0.5)
    ledger.episode_began(0, 0, 0)
    ledger.component(OBSERVE, 0, 250 * ms)
    observed(ledger, second, False, 0.0)
    observed(ledger, 6 * second, True, 3.0)
    ledger.component(ACT, 6 * second, 7 * second)
    ledger.learned_for(7 * second, 10 * second, Where.LOOP)
    observed(ledger, 12 * second, True, 3.0)
    ledger.episode_ended(EpisodeRecord(0, 0, 0, 12 * second))
    assert ledger.shares() == {"calm": {"observe": 0.25 / 6}, "urgent": {"act": 1 / 6, "learn": 0.5}}
    earned = ledger.by_parts()
    assert earned == pytest.approx([0.0, *[0.6] * 5, *[0.0] * 6])
