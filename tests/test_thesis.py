"""Experiment 1 of the thesis (section 3.4.1) under the virtual clock: what reaction times must be."""

from __future__ import annotations

import json

import numpy as np
import pytest
from parts import run_stopping
from scipy import stats

from rtagent import Result, ms
from rtagent_drivers.stopping import stopping_joint

DELAYS = (50, 100, 250, 500)


def experiment(preset: str, delay: int) -> Result:
    return run_stopping(preset, delay=delay * ms, trials=30, episodes=20, seed=1)


def last_reactions(result: Result) -> np.ndarray:
    """Return the reaction times of the last ten episodes of each trial, in ms."""
    return np.array(
        [
            reaction.time / ms
            for each in result.episodes
            if each.episode >= 10
            for reaction in each.reactions.reactions
        ]
    )


def mean_return(result: Result) -> float:
    return float(np.mean([each.total_reward for each in result.episodes if each.episode >= 10]))


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize(("preset", "least"), [("reactive", 0), ("standard", 1)])
@pytest.mark.slow
def test_reaction_times_are_uniform_over_one_learning_step(preset: str, least: int, delay: int) -> None:
    times = last_reactions(experiment(preset, delay))
    assert len(times) > 290
    assert abs(np.median(times) - (least + 0.5) * delay) < 0.1 * delay
    assert stats.kstest(times, "uniform", args=(least * delay, delay)).pvalue > 0.001


@pytest.mark.parametrize("preset", ["reactive", "standard"])
def test_without_delay_the_reaction_is_immediate(preset: str) -> None:
    assert last_reactions(experiment(preset, 0)).max() == 0.0


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.slow
def test_reactive_returns_are_better_than_standard_ones(delay: int) -> None:
    assert mean_return(experiment("reactive", delay)) > mean_return(experiment("standard", delay))


def test_both_schedules_meet_the_same_world() -> None:
    onsets = []
    for preset in ("reactive", "standard"):
        result = run_stopping(preset, episodes=5)
        onsets.append(
            [
                reaction.stimulus.time - each.began
                for each in result.episodes
                for reaction in each.reactions.reactions
            ]
        )
    assert onsets[0] == onsets[1]


def test_a_virtual_run_is_the_same_to_the_byte() -> None:
    first, second = (json.dumps(run_stopping(trials=2, seed=7).as_dict()) for _ in range(2))
    assert first == second
    assert first != json.dumps(run_stopping(trials=2, seed=8).as_dict())


@pytest.mark.slow
def test_the_real_clock_gives_the_same_medians() -> None:
    """Half a delay and a whole one more, of 10 ms here; compared with the time that learning really took."""
    medians = {}
    for preset in ("reactive", "standard"):
        joint = stopping_joint(onset=(50 * ms, 150 * ms))
        result = run_stopping(preset, delay=10 * ms, joint=joint, episodes=16, clock_name="real")
        learning = result.components()["learn"].median
        medians[preset] = result.reaction_time.median / learning
    assert 0.4 < medians["standard"] - medians["reactive"] < 1.6
    assert medians["reactive"] < 1.0
