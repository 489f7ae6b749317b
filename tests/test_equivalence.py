"""In a world that waits, every order in which each choice sees the same learned transitions learns the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from helpers import REACTIVE, STANDARD, rotations
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import Generator

from rtagent import Agent, Cost, Limits, Plan, Result, Schedule, Transition, clock, ms, run
from rtagent.costs import Costs
from rtagent.device import Device
from rtagent.experience import Command, FloatArray, Observation, Outcome, Stimulus, Values
from rtagent.features import Tabular
from rtagent.learning import ExpectedSarsa, QLearning, Sarsa
from rtagent.learning.control import Trace
from rtagent.policy import EpsilonGreedy
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, Order
from rtagent.specs import DeviceSpec, Spec
from rtagent.task import RewardMeter, Task
from rtagent.tasks import HallwayTask
from rtagent_drivers.fake import FakeDevice
from rtagent_drivers.hallway import hallway

ORDERS = list(dict.fromkeys(rotations(STANDARD) + rotations(REACTIVE)))
MOST_STEPS = 12


@dataclass(frozen=True)
class Mdp:
    """A Markov decision process: the rewards, and two places where each action may lead; state 0 is the end."""

    rewards: tuple[tuple[float, ...], ...]
    leads_to: tuple[tuple[tuple[int, int], ...], ...]

    @property
    def states(self) -> int:
        return len(self.rewards)

    @property
    def actions(self) -> int:
        return len(self.rewards[0])


class MdpWorld:
    """A synchronous world: it stays where it is until it is told to move; all chance is drawn beforehand."""

    def __init__(self, mdp: Mdp) -> None:
        self._mdp = mdp
        self.spec = DeviceSpec(
            sensors={"state": Spec.discrete(mdp.states), "reward": Spec()},
            actuators={"action": Spec.discrete(mdp.actions)},
            synchronous=True,
        )

    def begin(self, now: int, rng: Generator) -> None:
        self._state = int(rng.integers(1, self._mdp.states))
        self._coins = iter(rng.integers(2, size=1000).tolist())
        self._reward = 0.0

    def values(self, time: int) -> Values:
        return {"state": self._state, "reward": self._reward}

    def command(self, now: int, command: Command) -> Command:
        action = int(command["action"])
        self._reward += self._mdp.rewards[self._state][action]
        self._state = self._mdp.leads_to[self._state][action][next(self._coins)]
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        return ()

    def next_change(self, now: int) -> int | None:
        return None

    def make_safe(self, now: int) -> None:
        pass


class MdpTask:
    """Go through a process; it ends in state 0."""

    def __init__(self, mdp: Mdp) -> None:
        self.state = {"state": Spec.discrete(mdp.states)}
        self.actions = tuple(f"action {number}" for number in range(mdp.actions))
        self._reward = RewardMeter()

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None:
        pass

    def begin(self) -> None:
        self._reward.begin()

    def interpret(self, observation: Observation) -> Outcome:
        values = observation.samples["mdp"].values
        state = values["state"]
        assert isinstance(state, int)
        return Outcome((state,), self._reward.since_last(values["reward"]), terminated=state == 0)

    def commands(self, action: int) -> Mapping[str, Command]:
        return {"mdp": {"action": action}}

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return False


Learner = Sarsa | QLearning | ExpectedSarsa
LearnerMaker = Callable[..., Learner]


@dataclass(frozen=True)
class Case:
    """Everything about a run but its order."""

    make_world: Callable[[], Device]
    make_task: Callable[[], Task]
    device: str
    learner: LearnerMaker
    epsilon: float
    limits: Limits = field(default_factory=lambda: Limits(episode_steps=MOST_STEPS))
    episodes: int = 4
    seed: int = 0
    learn_delay: int = 0
    costs: Costs = field(default_factory=dict)


class Learned:
    """Keeps what was learned."""

    def __init__(self) -> None:
        self.transitions: list[tuple[object, ...]] = []

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        t = transition
        self.transitions.append(
            (
                t.features.indices.tolist(),
                t.action,
                t.probability,
                t.reward,
                t.next_features.indices.tolist(),
                t.next_action,
                t.terminated,
                t.truncated,
                delta,
            )
        )


@dataclass
class Story:
    """What came of a run."""

    transitions: list[tuple[object, ...]]
    weights: FloatArray
    result: Result

    @property
    def returns(self) -> list[float]:
        return [episode.total_reward for episode in self.result.episodes]


def tell(case: Case, order: Order) -> Story:
    """Run a case in this order."""
    task, learned, learners = case.make_task(), Learned(), []

    def make_agent(rng: Generator) -> Agent:
        features, policy = Tabular(state=task.state), EpsilonGreedy(epsilon=case.epsilon)
        learners.append(case.learner(size=features.size, actions=len(task.actions), policy=policy))
        return Agent(features, learners[0], policy, rng)

    async def main() -> Result:
        plan = Plan(episodes=case.episodes, seed=case.seed, limits=case.limits)
        schedule = Schedule(order, learn_delay=case.learn_delay)
        devices = {case.device: case.make_world()}
        return await run(devices, task, make_agent, schedule, plan, costs=case.costs, instruments=[learned])

    result = clock.run(main(), "virtual")
    return Story(learned.transitions, learners[0].weights, result)


def assert_all_the_same(case: Case, orders: Sequence[Order] = tuple(ORDERS)) -> Story:
    first = tell(case, orders[0])
    for order in orders[1:]:
        other = tell(case, order)
        assert other.transitions == first.transitions, f"{order} differs from {orders[0]}"
        assert other.weights.tobytes() == first.weights.tobytes()
        assert other.returns == first.returns
    return first


# Learners


def sarsa(trace: Trace = "accumulating", lambda_: float = 0.9) -> LearnerMaker:
    def make(*, size: int, actions: int, policy: EpsilonGreedy) -> Learner:
        return Sarsa(size=size, actions=actions, alpha=0.3, lambda_=lambda_, trace=trace)

    return make


def q_learning(*, size: int, actions: int, policy: EpsilonGreedy) -> Learner:
    return QLearning(size=size, actions=actions, alpha=0.3)


def expected_sarsa(*, size: int, actions: int, policy: EpsilonGreedy) -> Learner:
    return ExpectedSarsa(size=size, actions=actions, alpha=0.3, policy=policy)


LEARNERS: dict[str, LearnerMaker] = {
    "sarsa": sarsa(),
    "sarsa, replacing": sarsa("replacing"),
    "sarsa, no trace": sarsa(lambda_=0.0),
    "q_learning": q_learning,
    "expected_sarsa": expected_sarsa,
}


@st.composite
def mdps(draw: st.DrawFn) -> Mdp:
    states, actions = draw(st.integers(2, 5)), draw(st.integers(1, 3))
    places = st.integers(0, states - 1)
    rewards = st.floats(-2, 2, allow_subnormal=False)
    return Mdp(
        tuple(tuple(draw(rewards) for _ in range(actions)) for _ in range(states)),
        tuple(tuple((draw(places), draw(places)) for _ in range(actions)) for _ in range(states)),
    )


def case_of(mdp: Mdp, learner: LearnerMaker, epsilon: float = 0.2, **settings: object) -> Case:
    return Case(lambda: FakeDevice(MdpWorld(mdp)), lambda: MdpTask(mdp), "mdp", learner, epsilon, **settings)  # type: ignore[arg-type]  # the names are those of Case


@pytest.mark.parametrize("learner", LEARNERS.values(), ids=LEARNERS)
@given(
    mdp=mdps(),
    epsilon=st.sampled_from([0.0, 0.2, 1.0]),
    steps=st.sampled_from([2, 3, 5, MOST_STEPS]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=12)
def test_equivalent_orders_learn_the_same_bit_for_bit(
    learner: LearnerMaker, mdp: Mdp, epsilon: float, steps: int, seed: int
) -> None:
    case = case_of(mdp, learner, epsilon, limits=Limits(episode_steps=steps), seed=seed)
    story = assert_all_the_same(case)
    assert story.transitions
    assert all(1 <= episode.steps <= steps for episode in story.result.episodes)


@given(mdp=mdps(), seed=st.integers(0, 1000), costs=st.lists(st.integers(0, 3 * ms), min_size=4, max_size=4))
@settings(max_examples=10)
def test_what_the_components_cost_changes_nothing_in_a_world_that_waits(
    mdp: Mdp, seed: int, costs: list[int]
) -> None:
    of_components = dict(zip((ACT, OBSERVE, CHOOSE, LEARN), map(Cost, costs), strict=True))
    free = case_of(mdp, sarsa(), seed=seed)
    costly = case_of(mdp, sarsa(), seed=seed, costs=of_components, learn_delay=costs[0])
    plain, story = tell(free, REACTIVE), assert_all_the_same(costly, [REACTIVE, STANDARD])
    assert story.transitions == plain.transitions
    assert story.weights.tobytes() == plain.weights.tobytes()


@pytest.mark.parametrize("learner", LEARNERS.values(), ids=LEARNERS)
def test_equivalent_orders_learn_the_same_in_the_synchronous_hallway(learner: LearnerMaker) -> None:
    case = Case(
        lambda: hallway(synchronous=True),
        HallwayTask,
        "hallway",
        learner,
        0.1,
        limits=Limits(episode_steps=60),
        episodes=15,
    )
    story = assert_all_the_same(case)
    ends = [episode.truncated for episode in story.result.episodes]
    assert not all(ends)


# The comparison itself

SAD_PLACE = Mdp(rewards=((0.0, 0.0), (-1.0, -1.0)), leads_to=(((0, 0), (0, 0)), ((1, 1), (1, 1))))
GAMBLE = Mdp(rewards=((0.0, 0.0), (1.0, -1.0)), leads_to=(((0, 0), (0, 0)), ((1, 0), (0, 1))))


def test_an_order_in_which_choices_see_other_weights_learns_something_else() -> None:
    case = case_of(SAD_PLACE, q_learning, epsilon=0.0)
    reactive, eager = tell(case, REACTIVE), tell(case, (OBSERVE, LEARN, CHOOSE, ACT))
    # the eager order tries both actions in turn; the reactive one chooses before it has learned what was wrong
    assert [each[1] for each in eager.transitions[:2]] in ([0, 1], [1, 0])
    assert reactive.transitions != eager.transitions


def test_truncated_and_terminated_episodes_both_occur_in_the_comparison() -> None:
    story = assert_all_the_same(case_of(GAMBLE, sarsa(), episodes=20, limits=Limits(episode_steps=3)))
    assert {episode.truncated for episode in story.result.episodes} == {False, True}
    assert {transition[6:8] for transition in story.transitions} == {(False, False), (True, False), (False, True)}
    assert np.count_nonzero(story.weights) == 2


@pytest.mark.parametrize("order", ORDERS, ids="-".join)
@pytest.mark.parametrize("steps", [1, 2, 7])
def test_an_episode_that_is_limited_to_some_steps_has_so_many(order: Order, steps: int) -> None:
    endless = Mdp(rewards=((0.0,), (1.0,)), leads_to=(((1, 1),), ((1, 1),)))
    story = tell(case_of(endless, sarsa(), limits=Limits(episode_steps=steps)), order)
    assert [episode.steps for episode in story.result.episodes] == [steps] * 4
    assert story.returns == [float(steps)] * 4
    assert len(story.transitions) == 4 * steps


def algorithm_2(case: Case, mdp: Mdp, alpha: float, gamma: float, lambda_: float) -> FloatArray:
    """SARSA(λ) as the thesis prints it, with traces, in a plain loop; the dice are those of the run."""
    from rtagent.streams import stream

    policy, dice = EpsilonGreedy(epsilon=case.epsilon), stream(case.seed, "policy", 0)
    q = np.zeros((mdp.states, mdp.actions))
    for episode in range(case.episodes):
        world = MdpWorld(mdp)
        world.begin(0, stream(case.seed, "device", "mdp", 0, episode))
        traces, steps = np.zeros_like(q), 0
        state, earned = int(world.values(0)["state"]), 0.0
        action, _ = policy.choose(q[state], dice)
        while state != 0 and steps < case.limits.episode_steps:
            world.command(0, {"action": action})
            following, total = int(world.values(0)["state"]), float(world.values(0)["reward"])
            next_action = policy.choose(q[following], dice)[0] if following != 0 else 0
            value = q[following, next_action] if following != 0 else 0.0
            delta = total - earned + gamma * value - q[state, action]
            traces *= gamma * lambda_
            traces[state, action] += 1
            q += alpha * delta * traces
            state, action, earned, steps = following, next_action, total, steps + 1
    return q


@given(mdp=mdps(), seed=st.integers(0, 1000), steps=st.sampled_from([2, 5, MOST_STEPS]))
@settings(max_examples=25)
def test_the_whole_runtime_does_what_algorithm_2_does_in_a_plain_loop(mdp: Mdp, seed: int, steps: int) -> None:
    case = case_of(mdp, sarsa(), seed=seed, limits=Limits(episode_steps=steps))
    expected = algorithm_2(case, mdp, alpha=0.3, gamma=0.9, lambda_=0.9)
    assert tell(case, STANDARD).weights == pytest.approx(expected.T, rel=1e-9, abs=1e-9)
