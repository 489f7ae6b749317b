"""The runtime: orders, prologues, pacing, waiting, costs, several devices, prediction, choosers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pytest
from numpy.random import Generator
from parts import run_stopping, sarsa_agent

from rtagent import (
    Agent,
    Component,
    Cost,
    DeviceSpec,
    Limits,
    Plan,
    Result,
    RunError,
    Schedule,
    Spec,
    clock,
    ms,
    run,
)
from rtagent.errors import RunStuckError, ScheduleError, SpecError
from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus, Transition
from rtagent.features import Tabular
from rtagent.instruments import Instrument
from rtagent.learning import TD, QLearning, Sarsa
from rtagent.policy import EpsilonGreedy
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, Situation
from rtagent.tasks import HallwayTask, Stopping
from rtagent_drivers.fake import Sampling
from rtagent_drivers.hallway import hallway
from rtagent_drivers.stopping import stopping_joint


class Journal(Instrument):
    """Writes down which component ran when, and what was learned."""

    def __init__(self) -> None:
        self.components: list[Component] = []
        self.starts: list[int] = []
        self.transitions: list[Transition] = []
        self.observations: list[Observation] = []

    def component(self, component: Component, start: int, end: int) -> None:
        self.components.append(component)
        self.starts.append(start)

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        self.transitions.append(transition)

    def observed(self, observation: Observation, stimuli: object) -> None:
        self.observations.append(observation)


def test_the_standard_order_begins_with_its_prologue() -> None:
    journal = Journal()
    run_stopping("standard", episodes=1, instruments=[journal])
    assert journal.components[:6] == [OBSERVE, CHOOSE, ACT, OBSERVE, CHOOSE, LEARN]
    assert journal.components[-3:] == [ACT, OBSERVE, LEARN], "nothing is chosen after the end"


def test_the_reactive_order_needs_no_prologue() -> None:
    journal = Journal()
    run_stopping("reactive", episodes=1, instruments=[journal])
    assert journal.components[:7] == [OBSERVE, CHOOSE, ACT, OBSERVE, CHOOSE, ACT, LEARN]


def test_repeated_components_run_as_often_as_they_stand() -> None:
    journal = Journal()
    order = (OBSERVE, CHOOSE, ACT, LEARN, OBSERVE)
    run_custom(Schedule(order, learn_delay=20 * ms), instruments=[journal])
    acts = journal.components.count(ACT)
    assert journal.components.count(OBSERVE) >= 2 * acts - 1
    assert len(journal.transitions) == acts, "the second look adds no transition"


def run_custom(
    schedule: Schedule,
    *,
    make: object = None,
    episodes: int = 1,
    instruments: Iterable[object] = (),
    costs: dict[Component, Cost] | None = None,
    limits: Limits = Limits(episode_time=10_000 * ms),  # noqa: B008  # frozen: sharing it changes nothing
) -> Result:
    task = Stopping()

    async def main() -> Result:
        return await run(
            {"joint": stopping_joint()},
            task,
            make or sarsa_agent(task),  # type: ignore[arg-type]  # makers of agents
            schedule,
            Plan(episodes=episodes, limits=limits),
            costs=costs,
            instruments=instruments,
        )

    return clock.run(main(), "virtual")


def test_no_reward_is_lost_by_a_second_look() -> None:
    journal = Journal()
    result = run_custom(
        Schedule((OBSERVE, CHOOSE, ACT, LEARN, OBSERVE), learn_delay=30 * ms), instruments=[journal]
    )
    learned = sum(transition.reward for transition in journal.transitions)
    assert learned == pytest.approx(result.episodes[0].total_reward, abs=1e-12)
    assert sum(t.elapsed for t in journal.transitions) == result.episodes[0].duration


def test_an_order_that_cannot_work_is_refused_before_anything_opens() -> None:
    with pytest.raises(ScheduleError, match="learns from the next action"):
        run_custom(Schedule((ACT, OBSERVE, LEARN, CHOOSE), learn_delay=ms))


def test_a_learner_that_only_predicts_cannot_control() -> None:
    def make(rng: Generator) -> Agent:
        return Agent(Tabular(state=Stopping().state), TD(size=2), EpsilonGreedy(), rng)

    with pytest.raises(ScheduleError, match="it values no actions"):
        run_custom(Schedule.preset("reactive", learn_delay=ms), make=make)


def test_a_learner_of_action_values_needs_actions() -> None:
    def make(rng: Generator) -> Agent:
        return Agent(Tabular(state=Stopping().state), QLearning(size=2, actions=2), None, rng)

    with pytest.raises(ScheduleError, match="the order never acts"):
        run_custom(Schedule((OBSERVE, LEARN), period=ms), make=make)


def test_a_period_paces_the_cycle_on_a_grid() -> None:
    journal = Journal()
    run_stopping(delay=3 * ms, period=10 * ms, episodes=1, instruments=[journal])
    looks = [start for start, part in zip(journal.starts, journal.components, strict=True) if part is OBSERVE]
    assert set(np.diff(looks)) == {10 * ms}


@pytest.mark.parametrize("overrun", ["skip", "catch_up"])
def test_overruns_are_counted(overrun: str) -> None:
    schedule = Schedule.preset("reactive", learn_delay=25 * ms, period=10 * ms, overrun=overrun)
    journal = Journal()
    result = run_custom(schedule, instruments=[journal])
    counters = result.recorder.counters
    assert counters["overruns"] > 10
    looks = np.array([s for s, part in zip(journal.starts, journal.components, strict=True) if part is OBSERVE])
    gaps = np.diff(looks)[1:-1]
    if overrun == "skip":
        assert set(gaps) == {30 * ms}
        assert counters["skipped_periods"] >= 2 * (counters["overruns"] - 1)
    else:
        assert set(gaps) == {25 * ms}
        assert counters["skipped_periods"] == 0


def test_costs_are_charged_and_add_to_the_reaction() -> None:
    costs = {ACT: Cost(2 * ms), OBSERVE: Cost(5 * ms), CHOOSE: Cost(3 * ms)}
    result = run_custom(Schedule.preset("reactive"), costs=costs, episodes=20)
    reactions = [reaction for each in result.episodes for reaction in each.reactions.reactions]
    assert {reaction.acting for reaction in reactions} == {2 * ms}
    assert {reaction.deciding for reaction in reactions} == {8 * ms}
    assert all(0 <= reaction.sensing <= 10 * ms for reaction in reactions)
    assert {name: each.median for name, each in result.components().items()} == {
        "act": 2 * ms, "observe": 5 * ms, "choose": 3 * ms, "learn": 0,
    }  # fmt: skip


def test_a_drawn_cost_differs_each_time_and_not_between_runs() -> None:
    costs = {CHOOSE: Cost(ms, 5 * ms, "uniform")}
    first, second = (run_custom(Schedule.preset("reactive"), costs=costs) for _ in range(2))
    times = first.recorder.components[CHOOSE].values()
    assert times == second.recorder.components[CHOOSE].values()
    assert min(times) >= ms
    assert max(times) <= 5 * ms
    assert len(set(times)) > len(times) // 2


def test_observe_waits_for_a_fresh_sample() -> None:
    journal = Journal()
    joint = stopping_joint(sampling=Sampling(rate=100.0, delay=4 * ms))
    result = run_stopping(joint=joint, delay=ms, episodes=1, instruments=[journal])
    sequences = [observation.samples["joint"].sequence for observation in journal.observations]
    assert sequences == list(range(len(sequences))), "each sample once"
    assert {o.age("joint") for o in journal.observations} == {4 * ms}
    assert result.recorder.counters["observe_timeouts"] == 0


def test_observe_takes_the_latest_where_told_to() -> None:
    journal = Journal()
    joint = stopping_joint(sampling=Sampling(rate=100.0))
    run_stopping(joint=joint, delay=4 * ms, episodes=1, observe="latest", instruments=[journal])
    sequences = [observation.samples["joint"].sequence for observation in journal.observations]
    assert len(sequences) > len(set(sequences)), "the same sample again, rather than wait"


def test_observe_gives_up_waiting_after_its_timeout() -> None:
    joint = stopping_joint(sampling=Sampling(rate=10.0))
    result = run_stopping(joint=joint, delay=ms, episodes=1, observe_timeout=30 * ms)
    assert result.recorder.counters["observe_timeouts"] > 10


class TwoJoints(Stopping):
    """The stopping task with a second joint that is only watched."""

    def bind(self, devices: object) -> None:
        pass


def test_several_devices_are_merged_by_their_newest_samples() -> None:
    task, journal = TwoJoints(), Journal()
    devices = {
        "joint": stopping_joint(sampling=Sampling(rate=100.0)),
        "other": stopping_joint(sampling=Sampling(rate=30.0, delay=ms)),
    }

    async def main() -> Result:
        schedule = Schedule.preset("reactive", learn_delay=ms)
        return await run(devices, task, sarsa_agent(task), schedule, Plan(episodes=1), instruments=[journal])

    clock.run(main(), "virtual")
    looks = [(o.samples["joint"].sequence, o.samples["other"].sequence) for o in journal.observations]
    assert len(set(looks)) == len(looks), "every look has something fresh"
    assert [joint for joint, _ in looks] == sorted(joint for joint, _ in looks)
    for observation in journal.observations:
        assert 0 <= observation.age("joint") < 10 * ms
        assert observation.age("other") >= ms


class Metronome:
    """A world that counts its samples, for prediction only; the reward is the last bit of the count."""

    state = {"phase": Spec.discrete(4)}  # noqa: RUF012  # a constant
    actions = ()

    def bind(self, devices: object) -> None: ...
    def begin(self) -> None: ...

    def interpret(self, observation: Observation) -> Outcome:
        sequence = observation.samples["joint"].sequence
        return Outcome((sequence % 4,), float(sequence % 4 == 0))

    def commands(self, action: int) -> dict[str, Command]:
        return {}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return False


def test_a_run_without_act_and_choose_only_predicts() -> None:
    task = Metronome()
    features = Tabular(state=task.state)
    learner = TD(size=4, alpha=0.5, gamma=0.5, lambda_=0.0)
    joint = stopping_joint(sampling=Sampling(rate=100.0))

    async def main() -> Result:
        schedule = Schedule((OBSERVE, LEARN))
        plan = Plan(limits=Limits(episode_steps=400))
        return await run({"joint": joint}, task, Agent(features, learner), schedule, plan)

    result = clock.run(main(), "virtual")
    period = 1 - 0.5**4
    assert result.episodes[0].steps == 400
    assert learner.weights == pytest.approx([0.125 / period, 0.25 / period, 0.5 / period, 1 / period], rel=1e-3)


def test_a_frozen_agent_keeps_no_transitions() -> None:
    result = run_custom(Schedule((OBSERVE, CHOOSE, ACT), period=10 * ms), limits=Limits(episode_time=400 * ms))
    assert not result.agents[0].queue
    assert result.episodes[0].truncated
    assert result.recorder.components[LEARN].count == 0


class LearnsWhenCalm:
    """A chooser: reacts as `reactive` does, and learns two transitions at a time, every other cycle."""

    def __init__(self) -> None:
        self.cycles = 0

    def cycle(self, situation: Situation) -> Iterator[Component]:
        self.cycles += 1
        yield OBSERVE
        yield CHOOSE
        assert situation.action_pending
        yield ACT
        assert not situation.action_pending
        assert situation.observed_at <= situation.time
        if situation.queue_length >= 2:
            yield LEARN


def test_a_chooser_takes_the_place_of_a_list() -> None:
    journal = Journal()
    schedule = Schedule((OBSERVE, CHOOSE, ACT, LEARN), learn_delay=10 * ms, chooser=LearnsWhenCalm)
    result = run_custom(schedule, instruments=[journal])
    learns = "".join("L" if part is LEARN else "." for part in journal.components)
    assert "LL" in learns
    assert "LLL" not in learns[:-4]
    assert len(journal.transitions) == result.episodes[0].steps


def test_every_transition_is_learned_once_and_in_order() -> None:
    journal = Journal()
    result = run_stopping(episodes=4, instruments=[journal])
    assert len(journal.transitions) == sum(each.steps for each in result.episodes)
    assert [t.terminated for t in journal.transitions].count(True) == 4
    for before, after in zip(journal.transitions, journal.transitions[1:], strict=False):
        if not before.terminated:
            assert after.features is before.next_features
            assert after.action == before.next_action


def test_a_truncated_episode_bootstraps() -> None:
    journal = Journal()
    run_custom(
        Schedule.preset("reactive", learn_delay=10 * ms), limits=Limits(episode_steps=7), instruments=[journal]
    )
    last = journal.transitions[-1]
    assert len(journal.transitions) == 7
    assert last.truncated
    assert not last.terminated
    assert last.next_action is not None


@pytest.mark.parametrize("preset", ["standard", "reactive"])
def test_the_hallway_is_learned(preset: str) -> None:
    task = HallwayTask()

    def make(rng: Generator) -> Agent:
        features = Tabular(state=task.state)
        return Agent(features, Sarsa(size=2, actions=2), EpsilonGreedy(epsilon=0.05), rng)

    async def main() -> Result:
        schedule = Schedule.preset(preset, learn_delay=20 * ms)
        plan = Plan(episodes=100, limits=Limits(episode_time=5000 * ms))
        return await run({"hallway": hallway()}, task, make, schedule, plan)

    result = clock.run(main(), "virtual")
    best = -(0.6 + 0.3) / 2.0  # the way up to the opening from mid-start, and left, at 2 m/s
    late = np.median([each.total_reward for each in result.episodes[50:]])
    assert best - 0.1 < late < best + 0.05
    assert (
        result.response_time.count + result.response_time.missed + result.anticipated == result.reaction_time.count
    )


def test_q_learning_learns_the_same_task() -> None:
    def make(rng: Generator) -> Agent:
        return Agent(Tabular(state=Stopping().state), QLearning(size=2, actions=2), EpsilonGreedy(epsilon=0.1), rng)

    result = run_custom(Schedule((ACT, OBSERVE, LEARN, CHOOSE), learn_delay=50 * ms), make=make, episodes=60)
    weights = result.agents[0].learner.weights  # type: ignore[union-attr]  # it is a QLearning
    assert weights[1, 1] > weights[0, 1], "in Emergency stop is better"
    assert weights[0, 0] > weights[1, 0], "in Normal move is better"


def test_a_world_at_rest_under_a_free_agent_is_told_apart_from_progress() -> None:
    class Rest(Stopping):
        def interpret(self, observation: Observation) -> Outcome:
            return Outcome((0.0,))

    task = Rest()

    async def main() -> Result:
        return await run(
            {"joint": stopping_joint()}, task, sarsa_agent(task), Schedule.preset("reactive"), Plan(episodes=1)
        )

    with pytest.raises(RunError, match="cycles took no virtual time and nothing is going to happen") as caught:
        clock.run(main(), "virtual")
    assert isinstance(caught.value.__cause__, RunStuckError)


def test_a_task_whose_device_is_missing_is_refused() -> None:
    task = Stopping(joint="elbow")

    async def main() -> Result:
        return await run({"joint": stopping_joint()}, task, sarsa_agent(task), Schedule.preset("reactive"))

    with pytest.raises(SpecError, match="needs a device named 'elbow'; the scenario has joint"):
        clock.run(main(), "virtual")


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(ScheduleError, match="there is no preset 'lazy': use one of standard, reactive"):
        Schedule.preset("lazy")


def test_what_was_really_sent_is_told() -> None:
    sent: list[object] = []

    class Spy(Instrument):
        def acted(self, action: int, commands: object, start: int, end: int) -> None:
            sent.append(commands)

    run_stopping(episodes=1, instruments=[Spy()])
    assert {"joint": {"motion": 1}} in sent


def test_a_device_with_arrays_is_observed() -> None:
    class Hand:
        spec = DeviceSpec(sensors={"fingers": Spec(shape=(3,), low=0.0, high=1.0)})
        reads = 0

        async def open(self) -> None: ...
        async def read(self, newer_than: int) -> Sample:
            self.reads += 1
            now = clock.current().now()
            return Sample({"fingers": np.full(3, 0.5 if self.reads % 3 else 2.0)}, now, now, self.reads)

        async def act(self, command: Command) -> Command:
            return command

        async def make_safe(self) -> None: ...
        async def close(self) -> None: ...

    class Watch(Metronome):
        def interpret(self, observation: Observation) -> Outcome:
            assert float(np.max(observation.samples["hand"].values["fingers"])) == 0.5
            return Outcome((0,))

    async def main() -> Result:
        task = Watch()
        agent = Agent(Tabular(state=task.state), TD(size=4))
        plan = Plan(limits=Limits(episode_steps=30))
        return await run({"hand": Hand()}, task, agent, Schedule((OBSERVE, LEARN), period=ms), plan)

    result = clock.run(main(), "virtual")
    assert result.device_counters["hand"]["invalid_samples"] > 5
