"""An ordering that is learned: its steps by hand, its bounds, and that what it can express includes the presets."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from helpers import virtually
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS, run_stopping, sarsa_agent
from test_backlog import bits

from rtagent import Agent, Cost, Limits, Plan, Result, RunError, Schedule, ms, run, second, us
from rtagent import runtime as runtime_module
from rtagent.errors import ScenarioError, ScheduleError, SpecError
from rtagent.experience import Stimulus, Transition
from rtagent.instruments import Instrument
from rtagent.latch import Latch
from rtagent.learn import Learn, When, Where
from rtagent.orderer import Option, OptionValues, Orderer, Sight
from rtagent.ordering import Gauge, Ordering
from rtagent.scenario import assemble, load
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, ORDER, WAIT, Component
from rtagent.tasks import Stopping
from rtagent_drivers.fake import Sampling
from rtagent_drivers.stopping import stopping_joint

COSTS = {ACT: Cost(10 * us), OBSERVE: Cost(5 * us), CHOOSE: Cost(5 * us)}


# What is learned


def test_two_steps_by_hand() -> None:
    values = OptionValues((2,), 2, alpha=0.4, gamma=0.5, lambda_=0.8)
    # a pair has four weights, of its bin and of the whole state, for the option and for all; each moves by 0.1 δ
    assert values.update(0, 1, reward=1.0, elapsed=second, following=2.0) == 2.0  # 1 + 0.5 · 2 - 0
    assert values.of(0).tolist() == pytest.approx([0.4, 0.8])
    assert values.of(1).tolist() == [0.0, 0.0]
    # no time has passed, so γ is 1; the trace of the first pair is 0.5 · 0.8 now
    assert values.update(1, 0, reward=0.0, elapsed=0, following=0.8) == pytest.approx(0.8)
    assert values.of(1).tolist() == pytest.approx([0.32, 0.16])
    assert values.of(0).tolist() == pytest.approx([0.4 + 0.064, 0.8 + 0.128])
    values.cut()
    before = values.of(0).tolist()
    values.update(1, 1, reward=5.0, elapsed=0, following=0.0)
    assert values.of(0).tolist() == before, "the trace was cut"


class Plain:
    """The same by its definition: features by name, in dictionaries."""

    def __init__(self, shape: Sequence[int], alpha: float, gamma: float, lambda_: float) -> None:
        self.shape, self.gamma, self.lambda_ = shape, gamma, lambda_
        self.step = alpha / (2 * (len(shape) + 1))
        self.weights: dict[Any, float] = {}
        self.trace: dict[Any, float] = {}

    def features(self, state: int, option: int) -> list[Any]:
        bins = []
        for count in reversed(self.shape):
            state, place = divmod(state, count)
            bins.append(place)
        named = [*enumerate(reversed(bins)), tuple(bins)]
        return [(each, which) for each in named for which in (option, "any")]

    def value(self, state: int, option: int) -> float:
        return sum(self.weights.get(each, 0.0) for each in self.features(state, option))

    def update(self, state: int, option: int, reward: float, elapsed: int, following: float) -> None:
        gamma = self.gamma ** (elapsed / 1e9)
        delta = reward + gamma * following - self.value(state, option)
        self.trace |= dict.fromkeys(self.features(state, option), 1.0)
        for each, trace in self.trace.items():
            self.weights[each] = self.weights.get(each, 0.0) + self.step * delta * trace
            self.trace[each] = trace * gamma * self.lambda_


SHAPE = (3, 1, 2)
STEPS = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 2), st.floats(-3, 3), st.integers(0, 3 * second), st.floats(-3, 3)),
    max_size=25,
)


@given(STEPS, st.floats(0.01, 1), st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=40, deadline=None)
def test_it_learns_what_the_plain_form_does(steps: Any, alpha: float, gamma: float, lambda_: float) -> None:
    fast, plain = OptionValues(SHAPE, 3, alpha, gamma, lambda_), Plain(SHAPE, alpha, gamma, lambda_)
    for step in steps:
        fast.update(*step)
        plain.update(*step)
    for state in range(6):
        assert fast.of(state) == pytest.approx([plain.value(state, option) for option in range(3)], abs=1e-9)


def test_what_is_not_finite_is_never_learned() -> None:
    values = OptionValues((2,), 2, 0.4, 0.5, 0.8)
    assert np.isnan(values.update(0, 0, float("nan"), ms, 0.0))
    assert not values.weights.any()


# What may be decided


@dataclass
class Around:
    """Surroundings of a decision, made up."""

    time: int = second
    observed_at: int = second - ms
    queue_length: int = 0
    action_pending: bool = False
    reward: float = 0.0
    urgency: Sequence[float] = (0.0,)
    has_observed: bool = True
    fresh: bool = False
    change: bool = False
    news: bool = False
    observable: bool = False


def orderer(seed: int = 0, **rules: Any) -> Orderer:
    made = Orderer(Ordering(**rules), np.random.default_rng(seed))
    made.begin(0)
    return made


SITUATIONS = st.builds(
    Around,
    time=st.integers(0, 3 * second),
    observed_at=st.just(0),
    queue_length=st.integers(0, 30),
    action_pending=st.booleans(),
    has_observed=st.booleans(),
    fresh=st.booleans(),
    change=st.booleans(),
    news=st.booleans(),
    observable=st.booleans(),
)


@given(SITUATIONS, st.integers(0, 9))
def test_what_it_decides_is_possible_and_what_is_overdue_is_done(around: Around, seed: int) -> None:
    made = orderer(seed, look_within=50 * ms, act_within=second)
    option = made.decide(around)
    assert option in made.allowed(around)
    assert around.fresh or option is not Option.ACT
    assert around.queue_length or option is not Option.LEARN
    assert not (around.news and option is Option.WAIT)
    if not around.has_observed:
        assert option is Option.OBSERVE
    elif around.action_pending or around.time >= second:
        assert option is (Option.ACT if around.fresh else option)
        assert around.fresh or not around.observable or option is Option.OBSERVE
    elif around.observable and around.time >= 50 * ms:
        assert option is Option.OBSERVE


def test_an_act_begins_the_time_within_which_the_next_is_due_anew() -> None:
    made = orderer(act_within=100 * ms)
    fresh = Around(time=150 * ms, observed_at=149 * ms, fresh=True, queue_length=1)
    assert made.decide(fresh) is Option.ACT
    assert set(made.allowed(replace(fresh, time=200 * ms, observed_at=199 * ms))) == {
        Option.ACT,
        Option.LEARN,
        Option.WAIT,
    }
    assert made.allowed(replace(fresh, time=250 * ms, observed_at=249 * ms)) == (Option.ACT,)


def test_each_part_of_a_situation_has_bins_of_its_own() -> None:
    made = orderer(
        urgency=(Gauge(bounds=(0.5,)), Gauge(signal="a.b", bounds=(1.0, 2.0))), queue=(1, 4), age=(5 * ms,)
    )
    assert made.shape == (2, 3, 3, 2, len(Sight))
    around = Around(urgency=(0.7, 1.5), queue_length=3, observed_at=second - 6 * ms, fresh=True, change=True)
    assert np.unravel_index(made.place(around), made.shape) == (1, 1, 1, 1, Sight.CHANGE)
    assert np.unravel_index(made.place(replace(around, news=True, change=False)), made.shape)[-1] == Sight.NEWS
    assert np.unravel_index(made.place(replace(around, change=False)), made.shape)[-1] == Sight.OBSERVED
    assert np.unravel_index(made.place(Around(urgency=(0.0, 0.0))), made.shape) == (0, 0, 0, 0, Sight.NOTHING)


def test_it_learns_to_do_what_is_rewarded() -> None:
    """Acting earns 1 while it is urgent and costs 1 else; nothing else earns anything."""
    made, rng, earned = orderer(epsilon=0.05), np.random.default_rng(1), 0.0
    late: list[bool] = []
    for number in range(3000):
        urgent = bool(rng.integers(2))
        around = Around(
            number * 10 * ms, number * 10 * ms - ms, 1, reward=earned, urgency=(float(urgent),), fresh=True
        )
        acts = made.decide(around) is Option.ACT
        earned += (1.0 if urgent else -1.0) if acts else 0.0
        late += [acts == urgent] if number > 2000 else []
    assert np.mean(late) > 0.85


# What it can express


class Prefers(Orderer):
    """Always decides for the first of some options that may be; it learns nothing."""

    preferred: Sequence[Option] = ()

    def _choose(self, state: int, allowed: tuple[Option, ...]) -> Option:
        return next(option for option in self.preferred if option in allowed)


class Journal(Instrument):
    """Keeps what was learned, and which components ran."""

    def __init__(self) -> None:
        self.transitions: list[Transition] = []
        self.components: list[Component] = []

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        self.transitions.append(transition)

    def component(self, component: Component, start: int, end: int) -> None:
        self.components.append(component)


def one_episode(schedule: Schedule, seed: int, rate: float, journal: Journal) -> Result:
    task = Stopping()

    async def main() -> Result:
        joint = stopping_joint(onset=(500 * ms, 1500 * ms), sampling=Sampling(rate=rate))
        plan = Plan(1, 1, seed, Limits(episode_time=2 * second))
        return await run(
            {"joint": joint}, task, sarsa_agent(task), schedule, plan, costs=COSTS, instruments=[journal]
        )

    return virtually(main())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("preset", "slices", "preferred"),
    [
        ("reactive", 0, (Option.ACT, Option.LEARN, Option.OBSERVE, Option.WAIT)),
        ("interruptible", ms, (Option.ACT, Option.OBSERVE, Option.LEARN, Option.WAIT)),
    ],
)
def test_with_a_fixed_preference_it_is_the_preset(
    preset: str, slices: int, preferred: Sequence[Option], seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Prefers, "preferred", preferred)
    monkeypatch.setattr(runtime_module, "Orderer", Prefers)
    found = []
    for name in (preset, "learned"):
        schedule = replace(Schedule.preset(name, learn_delay=7 * ms), learn=Learn(slice=slices))
        if schedule.ordering is not None:
            schedule = replace(schedule, ordering=Ordering(look_within=10 * second, act_within=10 * second))
        journal = Journal()
        result = one_episode(schedule, seed, 100.0, journal)
        listed = [each for each in journal.components if each not in (ORDER, WAIT, LEARN)]
        told = [(t.action, t.reward, t.elapsed, t.state, t.next_state) for t in journal.transitions]
        reward = result.episodes[0].total_reward
        found.append((listed, told, result.reaction_times, reward, bits(result.agents[0].learner.save())))
    assert found[0] == found[1]
    assert len(found[0][1]) > 30


# In a run


def scenario_run(name: str, *overrides: str) -> Result:
    return virtually(assemble(load(SCENARIOS / f"{name}.toml", overrides)).run())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["phases", "phases_stopping"])
def test_a_run_is_the_same_to_the_byte(name: str) -> None:
    short = "run.episodes=2" if name == "phases_stopping" else "run.episode_time=3s"
    first, again = (json.dumps(scenario_run(name, short).as_dict(), allow_nan=False) for _ in range(2))
    assert first == again


def test_its_decisions_and_its_waiting_are_told_and_charged() -> None:
    result = scenario_run("phases", "run.episode_time=3s", "costs.order=70us")
    components = result.components()
    assert components["order"].count > 30
    assert components["order"].median == components["order"].maximum == 70 * us
    assert 0 < components["wait"].maximum <= 5 * ms
    share = result.learning().share
    parts = sum(
        series.count * np.mean(series.values()) for series in result.recorder.components.values() if series.count
    )
    assert parts / result.recorder.elapsed + share == pytest.approx(1.0, abs=0.05)


class Heard(Instrument):
    """Keeps the stimuli that were observed."""

    def __init__(self) -> None:
        self.stimuli: list[Stimulus] = []

    def observed(self, observation: object, stimuli: Sequence[Stimulus]) -> None:
        self.stimuli += stimuli


def test_whatever_it_draws_the_world_is_the_same() -> None:
    heard = [Heard(), Heard()]
    for each, epsilon in zip(heard, (0.0, 1.0), strict=True):
        overrides = ["run.episode_time=15s", f"schedule.ordering.epsilon={epsilon}"]
        virtually(assemble(load(SCENARIOS / "phases.toml", overrides)).run([each]))
    one, other = (each.stimuli for each in heard)
    assert min(len(one), len(other)) > 10
    assert all(first == second for first, second in zip(one, other, strict=False))


class Stops(Instrument):
    """Trips the latch after so many observations."""

    def __init__(self, latch: Latch, after: int) -> None:
        self.latch, self.left = latch, after

    def observed(self, observation: object, stimuli: object) -> None:
        self.left -= 1
        if not self.left:
            self.latch.trip("person", "enough")


@pytest.mark.parametrize("after", [1, 7, 23])
def test_a_stop_makes_the_devices_safe_whatever_it_would_do_next(after: int) -> None:
    task, latch, joint = Stopping(), Latch(), stopping_joint(sampling=Sampling(rate=100.0))
    made_safe: list[int] = []
    world: Any = joint.world
    make_safe = world.make_safe
    world.make_safe = lambda now: (made_safe.append(now), make_safe(now))

    async def main() -> Result:
        schedule = Schedule.preset("learned", learn_delay=20 * ms)
        plan = Plan(episodes=5)
        return await run(
            {"joint": joint},
            task,
            sarsa_agent(task),
            schedule,
            plan,
            instruments=[Stops(latch, after)],
            latch=latch,
        )

    with pytest.raises(RunError, match="enough"):
        virtually(main())
    assert made_safe


def test_the_queue_keeps_to_its_bound_though_it_never_decides_to_learn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Prefers, "preferred", (Option.ACT, Option.OBSERVE, Option.WAIT, Option.LEARN))
    monkeypatch.setattr(runtime_module, "Orderer", Prefers)
    longest = 0

    class Longest(Instrument):
        def acted(self, *args: object) -> None:
            nonlocal longest
            longest = max(longest, len(agents[0].queue))

    agents: list[Agent] = []

    def make(rng: Any) -> Agent:
        agents.append(sarsa_agent(Stopping())(rng))
        return agents[-1]

    schedule = replace(Schedule.preset("learned", learn_delay=3 * ms), learn=Learn(slice=ms, queue=3))

    async def main() -> Result:
        joint = stopping_joint(sampling=Sampling(rate=100.0))
        return await run({"joint": joint}, Stopping(), make, schedule, Plan(), instruments=[Longest()])

    result = virtually(main())
    assert 3 <= longest <= 4
    assert result.recorder.counters["learned_under_backpressure"] > 10


def test_what_it_has_learned_goes_on_over_episodes_and_begins_anew_with_a_trial(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[Orderer] = []

    class Kept(Orderer):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            made.append(self)

    monkeypatch.setattr(runtime_module, "Orderer", Kept)
    run_stopping("learned", delay=5 * ms, trials=2, episodes=3, joint=stopping_joint(sampling=Sampling(rate=100.0)))
    assert len(made) == 2
    assert all(each.values.weights.any() for each in made)


def test_what_was_kept_goes_on_with_the_same_decisions() -> None:
    def decisions(made: Orderer, numbers: range) -> list[Option]:
        return [
            made.decide(
                Around(number * ms, number * ms - (number % 3) * 4 * ms, number % 5, reward=number % 7, fresh=True)
            )
            for number in numbers
        ]

    made = orderer(seed=3, epsilon=0.3)
    decisions(made, range(1, 200))
    again = orderer(seed=4, epsilon=0.3)
    again.restore(made.save())
    assert decisions(again, range(200, 400)) == decisions(made, range(200, 400))


def test_what_was_kept_with_other_bins_is_refused() -> None:
    with pytest.raises(SpecError, match="saved with other settings"):
        orderer(queue=(1, 2)).restore(orderer().save())


# What does not fit


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"queue": (4, 2)}, "queue is .*increase"),
        ({"wait": 0}, "wait is 0 or less"),
        ({"epsilon": 1.5}, "epsilon is 1.5"),
        ({"alpha": 0.0}, "alpha is 0.0"),
        ({"explored": -1.0}, "explored is -1.0"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ScheduleError, match=sentence):
        Ordering(**settings)


def test_a_gauge_is_one_thing() -> None:
    with pytest.raises(ScheduleError, match="signal and a prediction"):
        Gauge(signal="joint.position", prediction="x")


@pytest.mark.parametrize("learn", [Learn(where=Where.THREAD), Learn(when=When.CALM)])
def test_when_it_learns_is_for_it_to_decide(learn: Learn) -> None:
    with pytest.raises(ScheduleError, match="decides itself when it learns"):
        replace(Schedule.preset("learned"), learn=learn)


def problems(*overrides: str) -> Iterator[str]:
    with pytest.raises(ScenarioError) as caught:
        assemble(load(SCENARIOS / "phases_stopping.toml", overrides))
    yield from str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        (
            'schedule.ordering.urgency=[{prediction="emergence"}]',
            "schedule.ordering.urgency: there is no prediction",
        ),
        ('schedule.ordering.urgency=[{signal="joint.emergence"}]', "there is no signal 'joint.emergence'"),
        ("schedule.ordering.wayt=1", "there is no key 'schedule.ordering.wayt'"),
        ("schedule.ordering.wait=5", "has no unit"),
        ("schedule.ordering.gamma=2", "gamma is 2"),
        ("learn.when=calm", "decides itself when it learns"),
    ],
)
def test_a_scenario_is_told_what_is_wrong_with_its_ordering(override: str, sentence: str) -> None:
    assert any(sentence in problem for problem in problems(override))


def test_the_settings_of_an_ordering_count_only_where_it_is_learned() -> None:
    listed = assemble(load(SCENARIOS / "phases.toml", ["schedule.preset=reactive"])).schedule
    assert listed == replace(Schedule.preset("reactive"), learn_delay=150 * ms, learn=replace(listed.learn))
    assert assemble(load(SCENARIOS / "phases.toml")).schedule.ordering is not None
