"""The stopping task on a joint of an arm: rewards by hand, ends, and what does not fit."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from numpy.random import Generator

from rtagent import Agent, Plan, Schedule, run
from rtagent.errors import SpecError
from rtagent.experience import Command, Observation, Outcome, Sample, Stimulus, Values
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import Greedy
from rtagent.specs import DeviceSpec, Spec
from rtagent.tasks import ArmStopping
from rtagent.units import degree, ms, second
from rtagent_drivers.fake import FakeDevice, Sampling
from rtagent_drivers.timer import Timer
from tests.helpers import virtually

MOVE, STOP = 0, 1
ARM = DeviceSpec(
    sensors={
        "elbow_position": Spec(unit="rad", low=-1.0, high=1.0),
        "elbow_velocity": Spec(unit="rad/s", low=-5.0, high=5.0),
    },
    actuators={"elbow_velocity": Spec(unit="rad/s", low=-1.0, high=1.0)},
    rate=100.0,
)
DEVICES = {"arm": ARM, "timer": Timer.spec}


def task(**settings: object) -> ArmStopping:
    made = ArmStopping(
        **{"joint": "arm.elbow", "emergency": "timer.expired", "end": 0.95, "velocity": 0.5} | settings
    )  # type: ignore[arg-type]  # settings of many types
    made.bind(DEVICES)
    return made


def seen(task: ArmStopping, time: int, velocity: float, onset: int | None = None, position: float = 0.0) -> Outcome:
    arm = Sample({"elbow_position": position, "elbow_velocity": velocity}, time, time, time)
    timer = Sample({"expired": onset is not None}, onset or 0, onset or 0, int(onset is not None))
    return task.interpret(Observation(time, {"arm": arm, "timer": timer}))


def test_an_episode_by_hand() -> None:
    """Emergency comes at 30 ms, the joint is seen at rest at 70 ms: 40 ms of it; one needless stop before."""
    stopping = task(reward_unit=10 * ms)
    outcomes = [seen(stopping, 10 * ms, 0.5)]
    stopping.commands(STOP)
    outcomes.append(seen(stopping, 20 * ms, 0.0))
    stopping.commands(MOVE)
    outcomes.append(seen(stopping, 40 * ms, 0.5, onset=30 * ms))
    stopping.commands(STOP)
    outcomes.append(seen(stopping, 60 * ms, 0.2, onset=30 * ms))
    outcomes.append(seen(stopping, 70 * ms, 0.0, onset=30 * ms))
    assert [outcome.state for outcome in outcomes] == [(0.0,), (0.0,), (1.0,), (1.0,), (1.0,)]
    assert [outcome.reward for outcome in outcomes] == [0.0, -1.0, -1.0, -2.0, -1.0]
    assert [outcome.terminated for outcome in outcomes] == [False] * 4 + [True]


def test_a_joint_at_rest_that_was_not_told_to_stop_is_no_end() -> None:
    stopping = task()
    stopping.commands(MOVE)
    assert not seen(stopping, 20 * ms, 0.0, onset=10 * ms).terminated


def test_a_stop_chosen_in_normal_does_not_answer_the_emergency_that_follows() -> None:
    stopping = task()
    seen(stopping, 5 * ms, 0.5)
    stopping.commands(STOP)
    assert not seen(stopping, 20 * ms, 0.0, onset=10 * ms).terminated


@pytest.mark.parametrize(
    ("velocity", "end", "position", "over"),
    [(0.5, 0.9, 0.91, True), (0.5, 0.9, 0.89, False), (-0.5, -0.9, -0.91, True), (-0.5, -0.9, 0.91, False)],
)
def test_the_end_of_the_way_is_a_miss(velocity: float, end: float, position: float, over: bool) -> None:
    assert seen(task(velocity=velocity, end=end), 0, velocity, position=position).terminated is over


def test_an_emergency_that_is_latched_lasts_until_the_episode_ends() -> None:
    """A button that is let go before the joint is at rest; in the next episode it is forgotten."""
    for latched, states in ((True, [0.0, 1.0, 1.0]), (False, [0.0, 1.0, 0.0])):
        stopping = task(latched=latched)
        seen_states = [
            seen(stopping, time * ms, 0.5, onset).state[0] for time, onset in ((10, None), (20, 15), (30, None))
        ]
        assert seen_states == states
        moving = {"arm": Sample({"elbow_position": 0.0, "elbow_velocity": 0.5}, 0, 0, 0)}
        assert stopping.urgent({**moving, "timer": Sample({"expired": False}, 0, 0, 0)}) is latched
        stopping.begin()
        assert seen(stopping, 40 * ms, 0.5).state == (0.0,)


def test_a_button_that_is_held_from_before_is_no_emergency_until_it_is_pressed_anew() -> None:
    stopping = task(latched=True)
    looks = ((10, 5), (20, 5), (30, None), (40, 35))
    states = [seen(stopping, time * ms, 0.5, onset).state[0] for time, onset in looks]
    assert states == [0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(("velocity", "end", "obstacle", "left"), [(0.5, 0.9, 0.7, 0.4), (-0.5, -0.9, -0.2, 0.5)])
def test_what_is_left_to_an_obstacle_is_told(velocity: float, end: float, obstacle: float, left: float) -> None:
    stopping = task(velocity=velocity, end=end, obstacle=obstacle)
    joint = Sample({"elbow_position": 0.3, "elbow_velocity": velocity}, 7, 8, 0)
    assert stopping.seen({"arm": joint}) == pytest.approx((7, left, 0.5))
    assert (stopping.speed, stopping.button) == (0.5, "timer")


def test_it_is_urgent_until_the_joint_is_at_rest() -> None:
    stopping = task()
    for velocity, expired, urgent in ((0.5, False, False), (0.5, True, True), (0.0, True, False)):
        arm = Sample({"elbow_position": 0.0, "elbow_velocity": velocity}, 0, 0, 0)
        assert stopping.urgent({"arm": arm, "timer": Sample({"expired": expired}, 0, 0, 0)}) is urgent


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"joint": "elbow"}, "write the device and the name"),
        ({"joint": "arm.knee"}, "needs the sensor 'knee_position'"),
        ({"emergency": "arm.elbow_velocity"}, "not true or false"),
        ({"emergency": "button.pressed"}, "needs a device named 'button'"),
        ({"velocity": 2.0}, "velocity: 2.0 is outside"),
        ({"velocity": 0.0}, "velocity is 0"),
        ({"at_rest": 0.6}, "at_rest is above 0 and below"),
        ({"end": 1.5}, "end: 1.5 is outside"),
        ({"obstacle": 0.96}, "obstacle is 0.96 rad, not before the end"),
    ],
)
def test_what_does_not_fit_is_refused(settings: dict[str, object], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        task(**settings)


class Turning:
    """A joint that is as fast as it was told, at once."""

    spec = ARM

    def begin(self, now: int, rng: Generator) -> None:
        self._since, self._position, self._velocity = now, -0.9, 0.0

    def values(self, time: int) -> Values:
        position = self._position + self._velocity * (time - self._since) / second
        return {"elbow_position": min(max(position, -1.0), 1.0), "elbow_velocity": self._velocity}

    def command(self, now: int, command: Command) -> Command:
        self._position = float(self.values(now)["elbow_position"])
        self._since, self._velocity = now, float(command["elbow_velocity"])
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        return ()

    def next_change(self, now: int) -> int | None:
        return None

    def make_safe(self, now: int) -> None:
        self.command(now, {"elbow_velocity": 0.0})


def test_an_agent_learns_to_stop_it_and_reacts_after_half_a_learning_step() -> None:
    stopping = ArmStopping(joint="arm.elbow", emergency="timer.expired", end=0.95, velocity=30 * degree)
    devices = {"arm": FakeDevice(Turning(), Sampling(rate=100.0)), "timer": Timer()}
    schedule = Schedule.preset("reactive", learn_delay=50 * ms)
    features = Tabular(state=stopping.state)
    learner = Sarsa(size=features.size, actions=2, alpha=0.1, gamma=0.9, lambda_=0.9)
    agent = Agent(features, learner, Greedy())
    result = virtually(run(devices, stopping, agent, schedule, Plan(episodes=60, seed=1)))
    normal, emergency = (learner.action_values(features.encode((flag,))) for flag in (0.0, 1.0))
    assert normal[MOVE] > normal[STOP]
    assert emergency[STOP] > emergency[MOVE]
    assert 15 * ms < result.reaction_time.median < 35 * ms
    assert result.reaction_time.maximum <= 50 * ms
    assert result.response_time.count > 50
