"""A modelled person's trial, under the virtual clock: they practise with the control, then stop eggs blinded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from rtagent import clock
from rtagent.experiments.egg.attempts import Attempt, Judge
from rtagent.experiments.egg.conditions import in_conditions, shuffled
from rtagent.experiments.experiment import Cell, Row
from rtagent.experiments.scenarios import run_scenario, scenario
from rtagent.learning import ControlLearner
from rtagent.scenario import assemble, load
from rtagent.schedule import PRESETS
from rtagent.streams import stream
from rtagent.tasks import ArmStopping
from rtagent.units import ms

SPREADS_MS = (20.0, 50.0)
"""Between these the standard deviations of people's anticipated presses are drawn."""

SLICE = "2ms"
PEOPLE = 100_000
"""Fewer than so many have seeds of their own."""

LEARNED_IN = 40
"""So many episodes an agent learns in before it is frozen."""


@cache
def learned(preset: str, seed: int) -> ControlLearner:
    """Return what an agent has learned in `LEARNED_IN` episodes of `egg` with a modelled person."""
    settings = ["run.clock=virtual", f"run.seed={seed}", f"run.episodes={LEARNED_IN}", *scheduled(preset)]
    learner: ControlLearner = run_scenario("egg", settings).agents[0].learner  # type: ignore[assignment]  # it controls
    return learner


def scheduled(preset: str) -> list[str]:
    """Return the settings of a preset; one that learns in slices does so in longer ones, as these are fewer."""
    sliced = [f"learn.slice={SLICE}"] if PRESETS[preset].learn.slice else []
    return [f"schedule.preset={preset}", *sliced]


def spread_of(person: int, seed: int) -> float:
    """Return the standard deviation (ms) of the anticipated presses of a person, the same in every variant."""
    return float(stream(seed, "person", person).uniform(*SPREADS_MS))


def attempts(
    conditions: Sequence[str], learners: Mapping[str, ControlLearner], settings: Sequence[str], seed: int
) -> list[Attempt]:
    """Run one trial of `egg` with these conditions and further settings; return what came of its episodes."""
    assembly = assemble(load(scenario("egg"), ["run.clock=virtual", f"run.seed={seed}", *settings]))
    run, blinding = in_conditions(assembly, conditions, learners)
    assert isinstance(run.task, ArmStopping), "the scenario egg is of that task"
    judge = Judge(run.task, conditions)
    clock.run(run.run([blinding, judge]), "virtual")
    return judge.attempts


def measure(cell: Cell) -> Row:
    """Run the trials of the people of a cell; each has a spread of their own, and so has each trial its order."""
    people = [_person(cell, person) for person in range(cell["first"], cell["first"] + cell["people"])]
    return {"people": people}


def _person(cell: Cell, person: int) -> Mapping[str, Any]:
    seed, spread = cell["seed"] * PEOPLE + person, spread_of(person, cell["seed"])
    learners = {condition: learned(condition, cell["seed"]) for condition in cell["mixed"]}
    settings = [f"devices.arm.participant.spread={round(spread * ms)}ns", *cell["settings"]]
    came = attempts(_conditions(cell, seed), learners, settings, seed)
    return {"spread_ms": spread, "attempts": [each.as_dict() for each in came]}


def _conditions(cell: Cell, seed: int) -> list[str]:
    """Return the conditions of a trial; one that is alone is what is practised, too."""
    if len(cell["mixed"]) > 1:
        return shuffled(cell["mixed"], cell["control"], cell["each"], seed)
    conditions: list[str] = cell["mixed"] * (cell["control"] + cell["each"])
    return conditions
