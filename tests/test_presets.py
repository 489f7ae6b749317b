"""The presets: how quickly they react, that all learn the same, and what goes wrong beside learning."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import Any

import pytest
from helpers import RampWorld
from parts import run_stopping, sarsa_agent
from test_backlog import bits

from rtagent import (
    Agent,
    Cost,
    Limits,
    Plan,
    Result,
    RunError,
    Schedule,
    Spec,
    Supervision,
    clock,
    ms,
    run,
    second,
    us,
)
from rtagent.experience import (
    Command,
    Observation,
    Outcome,
    Sample,
    Stimulus,
    Transition,
)
from rtagent.features import SelectiveKanerva, Tabular
from rtagent.instruments import Instrument
from rtagent.learn import Condition, Full, Learn, When
from rtagent.learning import Demons, Horde, QLearning, Sarsa
from rtagent.policy import EpsilonGreedy, Greedy
from rtagent.schedule import ACT, CHOOSE, FIXED, LEARN, OBSERVE, PRESETS, Component
from rtagent.tasks import Signals, Stopping
from rtagent_drivers.arm import arm
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.stopping import stopping_joint

pytestmark = pytest.mark.slow

COSTS = {ACT: Cost(10 * us), OBSERVE: Cost(5 * us), CHOOSE: Cost(5 * us)}
ALL_COSTS = 20 * us
SLICE = PRESETS["interruptible"].learn.slice
LEARNED = ("learned_in_place", "learned_deferred", "learned_under_backpressure", "transitions_shed")


class Journal(Instrument):
    """Keeps what was learned, and what was observed."""

    def __init__(self) -> None:
        self.transitions: list[Transition] = []
        self.observations: list[Observation] = []
        self.components: list[tuple[Component, int, int]] = []

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        self.transitions.append(transition)

    def observed(self, observation: Observation, stimuli: object) -> None:
        self.observations.append(observation)

    def component(self, component: Component, start: int, end: int) -> None:
        self.components.append((component, start, end))


def counted(result: Result) -> dict[str, int]:
    learning = result.as_dict()["learning"]
    return {how: learning[how] for how in LEARNED} | {
        "transitions_not_learned": result.recorder.counters["transitions_not_learned"]
    }


def closed(result: Result) -> int:
    return sum(episode.steps for episode in result.episodes)


# How quickly they react, under the virtual clock, with 500 ms of learning


def run_thesis(preset: str, episodes: int, *, learn: Learn | None = None, **settings: Any) -> Result:
    """Run the stopping task with 500 ms of learning and components that take time."""
    task, joint = Stopping(), settings.pop("joint", None) or stopping_joint()
    rules = learn or PRESETS[preset].learn

    async def main() -> Result:
        schedule = replace(Schedule.preset(preset, learn_delay=500 * ms, **settings), learn=rules)
        plan = Plan(episodes=episodes, limits=Limits(episode_time=10 * second))
        return await run({"joint": joint}, task, sarsa_agent(task), schedule, plan, costs=COSTS)

    return clock.run(main(), "virtual")


@pytest.mark.parametrize(("preset", "expected"), [("standard", 750 * ms), ("reactive", 250 * ms)])
def test_in_one_piece_learning_delays_the_reaction_as_in_the_thesis(preset: str, expected: int) -> None:
    reactions = run_thesis(preset, 300).reaction_times
    assert abs(median(reactions) - expected) <= 50 * ms


def test_interruptible_reacts_within_a_slice_and_what_the_components_cost() -> None:
    reactions = run_thesis("interruptible", 8).reaction_times
    assert len(reactions) == 8
    assert all(ALL_COSTS <= reaction <= SLICE + ALL_COSTS for reaction in reactions)
    assert max(reactions) > ALL_COSTS + SLICE // 2, "a slice is not left off in its middle"


def test_background_reacts_in_what_the_components_cost() -> None:
    assert set(run_thesis("background", 100).reaction_times) == {ALL_COSTS}


def test_deferred_is_late_by_one_update_at_most_when_urgency_comes_unannounced() -> None:
    reactions = run_thesis("deferred", 100).reaction_times
    assert all(ALL_COSTS <= reaction <= 500 * ms + ALL_COSTS for reaction in reactions)
    assert max(reactions) > 400 * ms


def test_deferred_is_not_late_when_urgency_was_announced() -> None:
    announced = replace(PRESETS["deferred"].learn, urgent=Condition(signal="joint.position", above=0.3))
    joint = stopping_joint(onset=(1000 * ms, 1500 * ms))
    result = run_thesis("deferred", 50, learn=announced, joint=joint)
    assert set(result.reaction_times) == {ALL_COSTS}
    assert counted(result)["learned_deferred"] > 50
    assert sum(counted(result).values()) == closed(result)


@pytest.mark.parametrize("rate", [50.0, 400.0])
@pytest.mark.parametrize("preset", ["deferred", "interruptible", "background"])
def test_the_presets_react_as_quickly_to_samples_that_come_by_themselves(preset: str, rate: float) -> None:
    joint = stopping_joint(sampling=Sampling(rate=rate, delay=ms))
    result = run_thesis(preset, 6, joint=joint, learn=replace(PRESETS[preset].learn, queue=100_000))
    late = {"deferred": 500 * ms, "interruptible": SLICE, "background": 0}[preset]
    until_sensed = round(second / rate) + ms
    assert all(reaction <= until_sensed + late + ALL_COSTS for reaction in result.reaction_times)
    assert len(result.reaction_times) + result.anticipated == 6


def test_what_was_observed_after_a_long_update_is_the_newest_there_is() -> None:
    joint, journal, task = stopping_joint(sampling=Sampling(rate=100.0, delay=ms)), Journal(), Stopping()

    async def main() -> Result:
        schedule = Schedule.preset("deferred", learn_delay=500 * ms)
        return await run(
            {"joint": joint}, task, sarsa_agent(task), schedule, Plan(episodes=5), instruments=[journal]
        )

    clock.run(main(), "virtual")
    assert max(observation.age("joint") for observation in journal.observations) <= 11 * ms


# All learn the same


def arm_schedule(preset: str, delay: int) -> Schedule:
    """Return an order that only predicts, with the learning rule of a preset; half of the time is urgent."""
    rules = PRESETS[preset].learn
    if rules.when is When.CALM:
        rules = replace(rules, urgent=Condition(signal="arm.elbow_position", above=1.0))
    return Schedule((OBSERVE, LEARN), preset, rules, learn_delay=delay)


def predict_arm(
    preset: str, *, delay: int = 20 * ms, steps: int = 300, clock_name: clock.ClockName = "virtual"
) -> Any:
    task, device, journal = Signals(), arm(joints=3, sampling=Sampling(rate=30.0)), Journal()
    task.bind({"arm": device.spec})

    def make(rng: Any = None) -> Agent:
        coder = SelectiveKanerva(state=task.state, prototypes=300, eta=0.05)
        demons = (Demons(gammas=(0.5, 0.9), bins=4),)
        return Agent(coder, Horde(size=coder.size, active=coder.active, state=task.state, demons=demons))

    async def main() -> Result:
        plan = Plan(limits=Limits(episode_steps=steps))
        return await run({"arm": device}, task, make, arm_schedule(preset, delay), plan, instruments=[journal])

    return clock.run(main(), clock_name), journal, make()


def test_where_transitions_do_not_depend_on_choices_all_presets_end_with_the_same_weights() -> None:
    saved = {}
    for preset in PRESETS:
        result, journal, fresh = predict_arm(preset)
        assert len(journal.transitions) == closed(result) == sum(counted(result).values()) == 300
        saved[preset] = bits(result.agents[0].learner.save())
        assert saved[preset] == relearned(fresh.learner, journal.transitions)
        deferred = counted(result)["learned_deferred"]
        assert (deferred > 50) == (preset == "deferred")
    del saved["deferred"]  # it catches up in one go, and does not look meanwhile: these are other transitions
    assert all(each == saved["standard"] for each in saved.values())


class Coins:
    """A synchronous walk whose steps are tossed beforehand, whatever is done; the reward is where it is."""

    def __init__(self) -> None:
        world = RampWorld()
        self.spec = replace(
            world.spec, sensors={"place": Spec.discrete(8)}, actuators={"move": Spec.discrete(2)}, synchronous=True
        )

    def begin(self, now: int, rng: Generator[Any, Any, Any] | Any) -> None:
        self._coins, self._place = iter(rng.integers(0, 8, size=1000).tolist()), 4

    def values(self, time: int) -> Mapping[str, Any]:
        return {"place": self._place}

    def command(self, now: int, command: Command) -> Command:
        self._place = next(self._coins)
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        return ()

    def next_change(self, now: int) -> None:
        return None

    def make_safe(self, now: int) -> None:
        pass


class Walk:
    """Watch the walk; place 0 ends an episode, and the upper half is urgent."""

    state = {"place": Spec.discrete(8)}  # noqa: RUF012  # a constant
    actions = ("left", "right")

    def bind(self, devices: object) -> None: ...
    def begin(self) -> None: ...

    def interpret(self, observation: Observation) -> Outcome:
        place = observation.samples["walk"].values["place"]
        return Outcome((place,), float(place), place == 0)  # type: ignore[arg-type]  # it is a number

    def urgent(self, samples: Mapping[str, Sample]) -> bool:
        return bool(samples["walk"].values["place"] >= 4)

    def commands(self, action: int) -> Mapping[str, Command]:
        return {"walk": {"move": action}}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return False


def walk(
    preset: str, *, learner: Any = None, clock_name: clock.ClockName = "virtual", delay: int = 3 * ms, **rules: Any
) -> tuple[Result, Journal]:
    task, journal = Walk(), Journal()

    def make(rng: Any) -> Agent:
        made = learner() if learner else Sarsa(size=8, actions=2, gamma_per="step")
        return Agent(Tabular(state=task.state), made, EpsilonGreedy(epsilon=1.0), rng)

    async def main() -> Result:
        preset_rules = replace(PRESETS[preset].learn, **rules)
        schedule = replace(Schedule.preset(preset, learn_delay=delay), learn=preset_rules)
        plan = Plan(episodes=12, limits=Limits(episode_steps=20))
        devices = {"walk": FakeDevice(Coins())}
        return await run(devices, task, make, schedule, plan, costs=COSTS, instruments=[journal])

    return clock.run(main(), clock_name), journal


@pytest.mark.parametrize("queue", [1000, 3])
def test_where_choices_do_not_depend_on_the_weights_control_learns_the_same_too(queue: int) -> None:
    runs = {preset: walk(preset, queue=queue) for preset in PRESETS}
    for result, journal in runs.values():
        assert len(journal.transitions) == closed(result) == sum(counted(result).values())
    saved = {preset: bits(result.agents[0].learner.save()) for preset, (result, _) in runs.items()}
    assert all(each == saved["standard"] for each in saved.values())
    waited = counted(runs["deferred"][0])
    assert waited["learned_deferred"] + waited["learned_under_backpressure"] > 20
    assert (waited["learned_under_backpressure"] > 0) == (queue == 3)


def relearned(learner: Any, transitions: Sequence[Transition]) -> Any:
    for transition in transitions:
        learner.update(transition)
    return bits(learner.save())


@pytest.mark.parametrize("preset", PRESETS)
def test_in_real_time_what_was_closed_was_learned_in_its_order(preset: str) -> None:
    result, journal, fresh = predict_arm(preset, delay=2 * ms, steps=9, clock_name="real")
    assert len(journal.transitions) == closed(result) == sum(counted(result).values()) == 9
    for before, after in zip(journal.transitions, journal.transitions[1:], strict=False):
        assert before.truncated or after.features is before.next_features
    assert bits(result.agents[0].learner.save()) == relearned(fresh.learner, journal.transitions)


@pytest.mark.parametrize("preset", PRESETS)
def test_control_in_real_time_learns_each_transition_once(preset: str) -> None:
    result, journal = walk(preset, clock_name="real", delay=200 * us)
    assert len(journal.transitions) == closed(result) == sum(counted(result).values())
    fresh = Sarsa(size=8, actions=2)
    assert bits(result.agents[0].learner.save()) == relearned(fresh, journal.transitions)


@pytest.mark.parametrize("preset", PRESETS)
def test_two_virtual_runs_are_the_same_to_the_byte(preset: str) -> None:
    joint_rate = Sampling(rate=200.0, delay=ms, jitter=2 * ms)
    runs = [
        run_stopping(preset, delay=7 * ms, episodes=3, joint=stopping_joint(sampling=joint_rate)) for _ in range(2)
    ]
    first, again = (json.dumps(result.as_dict(), allow_nan=False) for result in runs)
    assert first == again


# The queue of a run


@pytest.mark.parametrize("preset", ["deferred", "interruptible", "background"])
@pytest.mark.parametrize("full", list(Full))
def test_a_run_with_more_to_learn_than_time_keeps_to_its_queue(preset: str, full: Full) -> None:
    rules = replace(PRESETS[preset].learn, queue=4, full=full)
    joint = stopping_joint(sampling=Sampling(rate=100.0))
    task, longest = Stopping(), 0

    class Longest(Instrument):
        def component(self, component: Component, start: int, end: int) -> None:
            nonlocal longest
            longest = max(longest, len(agents[0].queue)) if component is ACT else longest

    agents: list[Agent] = []

    def make(rng: Any) -> Agent:
        agents.append(sarsa_agent(task)(rng))
        return agents[-1]

    async def main() -> Result:
        schedule = replace(Schedule.preset(preset, learn_delay=35 * ms), learn=rules)
        plan = Plan(episodes=3)
        return await run({"joint": joint}, task, make, schedule, plan, instruments=[Longest()])

    result = clock.run(main(), "virtual")
    told = counted(result)
    assert sum(told.values()) == closed(result)
    assert longest <= 5, "one more may be there until learning comes to it"
    pressed = told["transitions_shed" if full is Full.SHED else "learned_under_backpressure"]
    assert (pressed > 0) == (preset != "deferred" or pressed > 0)
    assert result.learned_all == (told["transitions_shed"] == 0)
    if preset != "deferred":
        assert pressed > 10


# Learning that raises


class Forgetful(Sarsa):
    """Fails at its tenth transition."""

    learned = 0

    def update(self, transition: Transition) -> float:
        self.learned += 1
        if self.learned == 10:
            raise RuntimeError("lost my weights")
        return super().update(transition)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("clock_name", ["real", "virtual"])
def test_learning_that_raises_ends_learning_and_not_acting(preset: str, clock_name: clock.ClockName) -> None:
    result, journal = walk(
        preset, learner=lambda: Forgetful(size=8, actions=2), clock_name=clock_name, delay=200 * us
    )
    assert len([episode for episode in result.episodes if episode.finished]) == 12, "it went on acting"
    assert len(journal.transitions) == 9
    (fault,) = result.faults
    assert (fault.source, fault.count, fault.fatal) == ("learning", 1, False)
    assert 'raise RuntimeError("lost my weights")' in fault.traceback
    assert not result.learned_all
    told = counted(result)
    assert told["transitions_not_learned"] >= 1
    assert sum(told.values()) == closed(result), "also those that came after it are counted"


# What results say


def test_the_share_of_learning_is_that_of_the_time_it_took() -> None:
    shares = {preset: walk(preset, queue=1)[0].as_dict()["learning"]["share"] for preset in FIXED}
    assert all(share == pytest.approx(3 * ms / (3 * ms + ALL_COSTS), rel=0.01) for share in shares.values()), shares


def test_the_slices_and_ages_of_a_run_are_told() -> None:
    learning = run_thesis("interruptible", 2).as_dict()["learning"]
    assert learning["slices"]["max_s"] == SLICE / second
    assert learning["slices"]["count"] > 1000
    assert 0.1 < learning["oldest_age"]["max_s"] < 0.6
    assert 0.9 < learning["share"] < 1.0


@pytest.mark.parametrize("preset", ["interruptible", "background"])
def test_what_follows_learning_in_a_cycle_is_not_charged_with_it(preset: str) -> None:
    task = Walk()
    rules = PRESETS[preset].learn

    async def main() -> Result:
        schedule = Schedule((ACT, OBSERVE, LEARN, CHOOSE), learn=rules, learn_delay=10 * ms)
        agent = Agent(Tabular(state=task.state), QLearning(size=8, actions=2), Greedy())
        plan = Plan(episodes=12, limits=Limits(episode_steps=10))
        return await run({"walk": FakeDevice(Coins())}, task, agent, schedule, plan, costs=COSTS)

    components = clock.run(main(), "virtual").components()
    assert components["choose"].maximum == 5 * us
    assert components["act"].maximum == 10 * us


# Devices


PATIENCE = {"joint": Supervision(timeout=300 * ms)}


@pytest.mark.parametrize("preset", PRESETS)
def test_a_device_that_hangs_is_found_within_its_budget_while_there_is_much_to_learn(preset: str) -> None:
    hangs = Faults(hang_at=tuple(range(200 * ms, 210 * ms, ms)))
    joint = stopping_joint(sampling=Sampling(rate=100.0), faults=hangs)
    delay = 4 * ms if preset in ("standard", "reactive") else 100 * ms
    with pytest.raises(RunError, match="has not answered") as caught:
        run_stopping(preset, joint=joint, supervision=PATIENCE, episodes=50, delay=delay)
    found = next(fault.time for fault in caught.value.result.faults if fault.fatal)
    assert found <= 210 * ms + 300 * ms + 100 * ms + 2 * delay


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("rate", [0.0, 100.0])
def test_a_device_that_is_unplugged_and_comes_back_is_used_again(preset: str, rate: float) -> None:
    joint = stopping_joint(sampling=Sampling(rate=rate), faults=Faults(disconnect=((400 * ms, 500 * ms),)))
    result = run_stopping(preset, joint=joint, supervision=PATIENCE, episodes=2, delay=5 * ms)
    assert result.device_counters["joint"]["reopened"] == 1
    assert [episode.finished for episode in result.episodes] == [True, True]
    assert sum(counted(result).values()) == closed(result)


class Onlooker(Stopping):
    """The stopping task beside further devices that are only watched."""

    def bind(self, devices: object) -> None: ...


@pytest.mark.parametrize("preset", PRESETS)
def test_each_new_sample_of_several_devices_is_news_once(preset: str) -> None:
    rates, task, journal = {"joint": 100.0, "other": 30.0, "third": 7.0}, Onlooker(), Journal()
    devices = {name: stopping_joint(sampling=Sampling(rate=rate)) for name, rate in rates.items()}

    async def main() -> Result:
        schedule = Schedule.preset(preset, learn_delay=ms)
        return await run(devices, task, sarsa_agent(task), schedule, Plan(episodes=2), instruments=[journal])

    result = clock.run(main(), "virtual")
    looks = [tuple(sample.sequence for sample in each.samples.values()) for each in journal.observations]
    begins = [place for place, look in enumerate(looks) if look == (0, 0, 0)]
    assert begins[0] == 0
    assert len(begins) == 2
    for episode in (looks[: begins[1]], looks[begins[1] :]):
        assert len(set(episode)) == len(episode), "none was taken twice"
        for device in zip(*episode, strict=True) if preset in FIXED else ():  # what is learned may look elsewhere
            assert sorted(set(device)) == list(range(max(device) + 1)), "none was lost"
    assert sum(counted(result).values()) == closed(result)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("rate", [0.0, 50.0])
def test_an_episode_begins_with_samples_of_its_own(preset: str, rate: float) -> None:
    journal = Journal()
    joint = stopping_joint(sampling=Sampling(rate=rate))
    result = run_stopping(preset, joint=joint, episodes=4, delay=30 * ms, instruments=[journal])
    begins = [episode.began for episode in result.episodes]
    for observation in journal.observations:
        began = max(begin for begin in begins if begin <= observation.time)
        assert observation.samples["joint"].world_time >= began


def test_begin_episode_ends_what_waits_for_a_sample_of_before() -> None:
    joint = stopping_joint(sampling=Sampling(rate=10.0))
    waiting: list[int] = []

    class Spied(FakeDevice):
        reads = 0

        async def read(self, newer_than: int) -> Sample:
            self.reads += 1
            try:
                return await super().read(newer_than)
            finally:
                self.reads -= 1

        async def begin_episode(self, rng: Any) -> None:
            await asyncio.sleep(0)
            await asyncio.sleep(0)  # what was cancelled has ended
            waiting.append(self.reads)
            await super().begin_episode(rng)

    spied = Spied(joint.world, Sampling(rate=10.0))
    run_stopping("interruptible", joint=spied, episodes=4, delay=30 * ms)
    assert waiting == [0, 0, 0, 0]


# What stops a run


@pytest.mark.parametrize("preset", PRESETS)
def test_after_a_fault_what_is_left_is_learned_or_counted(preset: str) -> None:
    joint = stopping_joint(sampling=Sampling(rate=100.0), faults=Faults(disconnect=((700 * ms,),)))
    with pytest.raises(RunError) as caught:
        run_stopping(preset, joint=joint, supervision=PATIENCE, delay=30 * ms, episodes=9)
    result = caught.value.result
    # a last transition may still wait for its next action
    assert closed(result) - 1 <= sum(counted(result).values()) <= closed(result)


def test_a_run_that_is_cancelled_leaves_no_thread() -> None:
    task, before = Stopping(), threading.active_count()

    async def main() -> None:
        schedule = Schedule.preset("background", period=ms)
        running = asyncio.ensure_future(run({"joint": stopping_joint()}, task, sarsa_agent(task), schedule))
        await asyncio.sleep(0.05)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    clock.run(main(), "real")
    assert threading.active_count() == before
