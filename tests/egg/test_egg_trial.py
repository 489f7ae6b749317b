"""A trial of Experiment 2: when each condition acts, by hand; conditions taking turns; agents that are frozen."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.random import Generator

from rtagent import Agent, clock
from rtagent.errors import ScheduleError
from rtagent.experiments.egg.attempts import Attempt, Judge
from rtagent.experiments.egg.conditions import (
    CONTROL,
    REACTIVE_SARSA,
    SARSA,
    Blinding,
    Frozen,
    Wired,
    in_conditions,
    shuffled,
)
from rtagent.experiments.egg.trial import attempts, learned, measure
from rtagent.experiments.egg.variants import VARIANTS, cells
from rtagent.experiments.experiment import Options
from rtagent.experiments.scenarios import scenario
from rtagent.learning import ControlLearner
from rtagent.scenario import Assembly, assemble, load
from rtagent.tasks import ArmStopping
from rtagent.units import degree, ms, second

LIVE = ("run.clock=virtual", "devices.arm.participant.strategy=live", 'devices.arm.start=["1s","1s"]')
WIRED = {CONTROL: Wired(), SARSA: Wired(), REACTIVE_SARSA: Wired()}
NORMAL, EMERGENCY = (0.0,), (1.0,)


class Finger:
    """Presses the button `after` (ns) each episode began."""

    def __init__(self, assembly: Assembly, after: int) -> None:
        self._press, self._after = assembly.devices["arm"].world.press, after  # type: ignore[attr-defined]  # a fake

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        self._press(time + self._after)


def tried(
    conditions: Sequence[str], after: int, *settings: str, learners: Mapping[str, ControlLearner] = WIRED
) -> list[Attempt]:
    """Return what came of episodes in which the button is pressed `after` (ns) their beginning."""
    assembly, blinding = in_conditions(assemble(load(scenario("egg"), [*LIVE, *settings])), conditions, learners)
    assert isinstance(assembly.task, ArmStopping)
    judge = Judge(assembly.task, conditions)
    clock.run(assembly.run([Finger(assembly, after), blinding, judge]), "virtual")
    return judge.attempts


@pytest.mark.parametrize(
    ("condition", "acts", "short"), [(CONTROL, 20, 15), (REACTIVE_SARSA, 20, 15), (SARSA, 70, 10)]
)
def test_an_episode_by_hand(condition: str, acts: int, short: int) -> None:
    """The arm is let go at 1 s; the agent looks every 50 ms; the press at 1.73 s is seen at 1.75 s.

    Reactive acts at once, at 70°: it turns 5° until it has 100°/s and so many less until it rests: 75°, 15° short.
    SARSA learns first: it acts at 1.8 s, 5° further. Reckoned back from full speed the arm began at 1.05 s.
    """
    (attempt,) = tried([condition], 1730 * ms)
    assert attempt.condition == condition
    assert attempt.pressed == pytest.approx(0.68)
    assert attempt.acted == pytest.approx(0.68 + acts / 1000)
    assert attempt.short == pytest.approx(short * degree, abs=1e-6)
    assert not attempt.broken


@pytest.mark.parametrize(("after", "broken"), [(1840, [False, False, True]), (1899, [True, True, True])])
def test_an_egg_breaks_where_the_joint_rests_at_it_or_beyond(after: int, broken: list[bool]) -> None:
    """Pressed at 1.84 s: reactive acts at 1.85 and rests at 85°, SARSA at 1.9 and at 90°, where the egg is."""
    assert [each.broken for each in tried([CONTROL, REACTIVE_SARSA, SARSA], after * ms)] == broken


def test_who_never_presses_crushes_the_egg() -> None:
    (attempt,) = tried([SARSA], 60 * second)
    assert (attempt.pressed, attempt.acted, attempt.broken) == (None, None, True)


def test_conditions_take_turns_in_one_run() -> None:
    mixed = [SARSA, CONTROL, REACTIVE_SARSA, SARSA, SARSA, REACTIVE_SARSA]
    lags = [each.acted - each.pressed for each in tried(mixed, 1730 * ms)]  # type: ignore[operator]  # both came
    assert lags == pytest.approx([0.07 if condition == SARSA else 0.02 for condition in mixed])


class Times:
    def __init__(self) -> None:
        self.acts: list[tuple[int, int]] = []

    def acted(self, action: int, sent: object, start: int, end: int) -> None:
        self.acts.append((action, end))


def acts(run: Assembly, *instruments: object) -> list[tuple[int, int]]:
    times = Times()
    clock.run(run.run([Finger(run, 1730 * ms), *instruments, times]), "virtual", 0)
    return times.acts


@pytest.mark.parametrize("preset", [SARSA, REACTIVE_SARSA])
def test_a_condition_acts_at_the_times_of_its_preset(preset: str) -> None:
    settings = [*LIVE, "run.episodes=3", f"schedule.preset={preset}"]
    run, blinding = in_conditions(assemble(load(scenario("egg"), settings)), [preset] * 3, WIRED)
    plain = assemble(load(scenario("egg"), settings))

    def wired(rng: Generator) -> Agent:
        agent = plain.make_agent(rng)
        return Agent(agent.features, Wired(), agent.policy, rng)

    assert acts(run, blinding) == acts(replace(plain, make_agent=wired))


@pytest.mark.parametrize("preset", [SARSA, REACTIVE_SARSA])
def test_agents_have_learned_to_move_in_normal_and_to_stop_in_emergency(preset: str) -> None:
    agent = assemble(load(scenario("egg"))).make_agent(np.random.default_rng(0))
    values = [learned(preset, 1).action_values(agent.features.encode(state)) for state in (NORMAL, EMERGENCY)]
    assert [int(each.argmax()) for each in values] == [0, 1]


def test_a_frozen_agent_learns_nothing_and_takes_as_long_as_learning() -> None:
    learner = learned(SARSA, 1)
    before = learner.weights  # type: ignore[attr-defined]  # a copy
    (attempt,) = tried([SARSA], 1730 * ms, "schedule.learn_delay=500ms", learners={SARSA: learner})
    assert attempt.acted == pytest.approx(0.68 + 0.77), "seen at 2 s, acted at 2.5 s"
    assert np.array_equal(learner.weights, before)  # type: ignore[attr-defined]


def test_each_condition_has_the_agent_that_learned_it() -> None:
    class Told:
        def __init__(self, value: float) -> None:
            self.value = value

        def action_values(self, features: object) -> float:
            return self.value

    blinding = Blinding([SARSA, REACTIVE_SARSA])
    frozen = Frozen({SARSA: Told(1.0), REACTIVE_SARSA: Told(2.0)}, blinding)  # type: ignore[dict-item]  # told so
    assert frozen.action_values(None) == 1.0  # type: ignore[arg-type]
    blinding.episode_began(0, 1, 0)
    assert frozen.action_values(None) == 2.0  # type: ignore[arg-type]


def test_conditions_that_learn_by_different_rules_are_not_mixed() -> None:
    assembly = assemble(load(scenario("egg"), LIVE))
    with pytest.raises(ScheduleError, match="background, reactive, standard learn by different rules"):
        in_conditions(assembly, [CONTROL, SARSA, "background"], {})


def test_a_trial_is_practised_and_then_shuffled_by_its_seed() -> None:
    trial = shuffled((SARSA, REACTIVE_SARSA), 10, 20, 3)
    assert trial[:10] == [CONTROL] * 10
    assert {condition: trial[10:].count(condition) for condition in (SARSA, REACTIVE_SARSA)} == {
        SARSA: 20,
        REACTIVE_SARSA: 20,
    }
    assert trial == shuffled((SARSA, REACTIVE_SARSA), 10, 20, 3) != shuffled((SARSA, REACTIVE_SARSA), 10, 20, 4)


def cell(**settings: Any) -> dict[str, Any]:
    trial = {"variant": "", "seed": 1, "first": 0, "people": 1, "control": 4, "each": 6}
    return {**trial, "mixed": [SARSA, REACTIVE_SARSA], "settings": []} | settings


def test_a_cell_is_measured_the_same_again_and_is_plain_data() -> None:
    rows = [json.dumps(measure(cell())) for _ in range(2)]
    assert rows[0] == rows[1] != json.dumps(measure(cell(first=1)))


def test_the_same_people_come_to_every_variant() -> None:
    """Who does not learn presses alike whatever the conditions are; the agent's lag is what differs."""
    fixed = ["devices.arm.participant.adaptation=0.0"]
    presses = []
    for mixed in ([SARSA, REACTIVE_SARSA], [SARSA], [REACTIVE_SARSA]):
        (person,) = measure(cell(mixed=mixed, settings=fixed, each=6 if len(mixed) == 2 else 12))["people"]
        presses.append([each["pressed"] for each in person["attempts"]])
    for others in presses[1:]:
        assert others == pytest.approx(presses[0])


@pytest.mark.slow
def test_who_learns_presses_sooner_after_being_late() -> None:
    """They know nothing of the lag at first, and in the mean have learned most of it after ten episodes."""
    control = [attempts([CONTROL] * 30, {}, [], seed) for seed in range(6)]
    presses = np.array([[each.pressed for each in person] for person in control], float).mean(0)
    assert presses[:2].mean() - presses[-10:].mean() == pytest.approx(0.075, abs=0.025), "25 ms, and 50 to brake"


def test_all_variants_are_cells_and_quick_ones_are_fewer() -> None:
    quick, full = (cells(Options(quick=quick)) for quick in (True, False))
    assert {each["variant"] for each in quick} == {each["variant"] for each in full} == set(VARIANTS)
    assert sum(each["people"] for each in quick) < sum(each["people"] for each in full) / 4
    assert json.loads(json.dumps(quick)) == quick


@pytest.mark.slow
@pytest.mark.parametrize("variant", list(VARIANTS))
def test_each_variant_runs(variant: str) -> None:
    one = {**next(each for each in cells(Options(quick=True)) if each["variant"] == variant), "people": 1}
    (person,) = measure({**one, "control": 1, "each": 1})["people"]
    assert all(each["pressed"] is not None for each in person["attempts"])


def test_other_costs_come_on_top() -> None:
    """With 1 ms for each look the agent looks every 51 ms: at 1.785 s, and SARSA acts 51 ms later."""
    (attempt,) = tried([SARSA], 1730 * ms, "costs.act=1ms")
    assert attempt.acted is not None
    assert attempt.pressed is not None
    assert 0.051 <= attempt.acted - attempt.pressed <= 0.102


@pytest.mark.slow
def test_the_bento_arm_does_the_same_on_its_fake() -> None:
    """It is sampled at 50 Hz and brakes at 1000°/s²: what is acted on in time rests short of the egg."""
    conditions = [CONTROL, SARSA, REACTIVE_SARSA] * 2
    settings = ["run.clock=virtual", "run.fake=process", 'devices.button.fake.every=["1.5s","1.9s"]']
    run, blinding = in_conditions(assemble(load(scenario("bento_egg"), settings)), conditions, WIRED)
    assert isinstance(run.task, ArmStopping)
    judge = Judge(run.task, conditions)
    clock.run(run.run([blinding, judge]), "virtual")
    for each in judge.attempts:
        assert each.pressed is not None
        assert each.acted is not None
        least, most = (0.05, 0.125) if each.condition == SARSA else (0.0, 0.075)
        assert least <= each.acted - each.pressed <= most
        assert each.short / degree == pytest.approx(130 - 60 * each.acted - 60**2 / 2000, abs=2.0)
        assert not each.broken
