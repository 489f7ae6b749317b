"""Hallway-World, going on by itself or step by step, and its task."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from helpers import read_in_any_order, visible
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Observation, Sample, Spec, Stimulus, ms, second
from rtagent.errors import SpecError
from rtagent.experience import Outcome
from rtagent.tasks import HallwayTask
from rtagent_drivers.fake import World
from rtagent_drivers.hallway import LEFT, UP, Floor, HallwayWorld, SynchronousHallwayWorld, hallway

START = 10**15
LENGTH, WIDTH, OPENING, PASSAGE, BOTTOM, SPEED = 1.0, 0.2, 0.3, 0.2, 0.1, 2.0
FLOOR = Floor(LENGTH, WIDTH, OPENING, PASSAGE, (BOTTOM, BOTTOM))
EVENTS = ("wall_left", "arrived")

Commands = list[tuple[int, int | None]]
COMMANDS = st.lists(st.tuples(st.integers(0, 900 * ms), st.sampled_from([UP, LEFT, None])), max_size=8)
TIMES = st.integers(0, 1500 * ms)


def world() -> HallwayWorld:
    made = HallwayWorld(FLOOR, SPEED)
    made.begin(START, np.random.default_rng(0))
    return made


def give(agent: HallwayWorld, commands: Sequence[tuple[int, int | None]]) -> None:
    """Command the agent, or make it safe (None)."""
    for when, action in sorted(commands, key=lambda command: command[0]):
        if action is None:
            agent.make_safe(START + when)
        else:
            agent.command(START + when, {"move": action})


class Story:
    """Hallway-World told from its rules: straight motions between commands, in seconds."""

    def __init__(self, commands: Commands) -> None:
        self.x, self.y, self.time, self.direction = WIDTH / 2, BOTTOM, 0.0, None
        self.hits: list[float] = []
        self.arrival: float | None = None
        for when, action in sorted(commands, key=lambda command: command[0]):
            self.go_on(when / second)
            if self.arrival is None:
                self.turn(action)

    def turn(self, action: int | None) -> None:
        if action is not None and action != self.direction and self.free(action) <= 0:
            self.hits.append(self.time)
            self.direction = None
        elif action != self.direction:
            self.direction = action

    def free(self, action: int) -> float:
        """Return how far it can go; the walls are a nanometre thick."""
        goal = PASSAGE if self.y >= LENGTH - OPENING - 1e-9 else 0.0
        way = LENGTH - self.y if action == UP else self.x + goal
        return way if way > 1e-9 else 0.0

    def go_on(self, until: float) -> None:
        if self.direction is not None:
            free = self.free(self.direction)
            way = min(free, (until - self.time) * SPEED)
            self.x, self.y = (self.x, self.y + way) if self.direction == UP else (self.x - way, self.y)
            if way == free:
                self.stop(self.time + way / SPEED)
        self.time = until

    def stop(self, when: float) -> None:
        self.direction = None
        if self.x < -PASSAGE + 1e-9:
            self.arrival = when
        else:
            self.hits.append(when)

    def values(self, time: int) -> dict[str, float | bool]:
        self.go_on(time / second)
        reward = -len(self.hits) - (self.arrival or 0.0)
        wall = self.y < LENGTH - OPENING - 1e-9
        return {"x": self.x, "y": self.y, "wall_left": wall, "arrived": self.arrival is not None, "reward": reward}


def on_the_edge(values: dict[str, float | bool]) -> bool:
    """Say whether rounding decides here what is seen."""
    return abs(float(values["y"]) - (LENGTH - OPENING)) < 1e-8


@given(COMMANDS, TIMES)
@settings(max_examples=300)
def test_the_sensors_show_what_the_rules_of_the_world_say(commands: Commands, time: int) -> None:
    agent = world()
    past = [command for command in commands if command[0] <= time]
    give(agent, past)
    values = agent.values(START + time)
    expected = Story(past).values(time)
    if not on_the_edge(expected):
        assert values == pytest.approx(expected, abs=1e-7)
    for name, value in values.items():
        assert agent.spec.sensors[name].problem(value) is None


@given(COMMANDS, st.lists(TIMES, max_size=12), st.integers(0, 99))
@settings(max_examples=100)
def test_what_is_read_at_a_time_does_not_depend_on_the_order_of_reading(
    commands: Commands, times: list[int], seed: int
) -> None:
    agent = world()
    give(agent, commands)
    moments = [START + time for time in times]
    for first, again in read_in_any_order(agent.values, moments, np.random.default_rng(seed)):
        assert first == again


@given(COMMANDS, COMMANDS, TIMES)
@settings(max_examples=150)
def test_a_command_changes_nothing_of_the_past(earlier: Commands, later: Commands, time: int) -> None:
    agent = world()
    give(agent, [command for command in earlier if command[0] <= time])
    before = agent.values(START + time)
    give(agent, [(time + 1 + when, action) for when, action in later])
    assert agent.values(START + time) == before


@given(COMMANDS, TIMES)
@settings(max_examples=200)
def test_nothing_happens_before_the_next_change_and_something_does_then(commands: Commands, wait: int) -> None:
    agent = world()
    give(agent, commands)
    now = START + max([when for when, _ in commands], default=0) + wait
    change = agent.next_change(now)
    assert change is None or change > now
    until = START + 9 * second if change is None else change - 1
    before, last = agent.values(now), agent.values(until)
    if not on_the_edge(dict(last)):
        assert visible(last, (*EVENTS, "reward")) == visible(before, (*EVENTS, "reward"))
    if change is None:
        assert last == before
    else:
        assert visible(agent.values(change), (*EVENTS, "reward")) != visible(before, (*EVENTS, "reward"))


@given(COMMANDS, st.lists(st.integers(-1, 1500 * ms), max_size=10))
@settings(max_examples=150)
def test_the_end_of_the_wall_is_a_stimulus_that_is_seen_once_and_when_it_is_felt(
    commands: Commands, looks: list[int]
) -> None:
    agent = world()
    give(agent, commands)
    times = [START - 1, *(START + when for when in sorted(looks)), START + 9 * second]
    seen = [s for after, until in pairwise(times) for s in agent.stimuli(after, until)]
    passes = not agent.values(START + 9 * second)["wall_left"]
    assert len(seen) == passes
    for stimulus in seen:
        assert not agent.values(stimulus.time)["wall_left"]
        assert agent.values(stimulus.time - 1000)["wall_left"]


def test_the_best_way_is_up_to_the_opening_and_left() -> None:
    agent = world()
    agent.command(START, {"move": UP})
    opening = agent.next_change(START)
    # 0.6 m up at 2 m/s, then 0.1 m to the wall line and 0.2 m through the passage
    assert opening == pytest.approx(START + 300 * ms, abs=2)
    agent.command(opening, {"move": LEFT})
    arrival = agent.next_change(opening)
    assert arrival == pytest.approx(START + 450 * ms, abs=2)
    assert not agent.values(arrival - 1)["arrived"]
    values = agent.values(arrival)
    assert values["arrived"]
    assert values["reward"] == pytest.approx(-0.45)
    assert agent.values(START + second) == values


def test_a_wall_is_hit_once_by_running_into_it_and_again_by_each_try() -> None:
    agent = world()
    agent.command(START, {"move": LEFT})
    # the wall is 0.1 m away
    assert agent.values(START + 49 * ms)["reward"] == 0
    assert agent.values(START + 51 * ms)["reward"] == -1
    assert agent.values(START + second)["reward"] == -1
    agent.command(START + second, {"move": LEFT})
    assert agent.values(START + second)["reward"] == -2
    agent.command(START + second, {"move": UP})
    assert agent.values(START + second + 449 * ms)["reward"] == -2
    assert agent.values(START + second + 451 * ms)["reward"] == -3


def test_the_same_command_again_changes_nothing_on_the_way() -> None:
    once, often = world(), world()
    give(once, [(0, UP)])
    give(often, [(when * ms, UP) for when in range(0, 440, 7)])
    for time in range(0, 1000, 13):
        assert often.values(START + time * ms) == once.values(START + time * ms)


def test_an_agent_that_is_made_safe_stays_where_it_is() -> None:
    agent = world()
    give(agent, [(0, UP), (100 * ms, None)])
    values = agent.values(START + 9 * second)
    assert (values["x"], values["y"]) == pytest.approx((WIDTH / 2, BOTTOM + 0.2))
    assert values["reward"] == 0
    assert agent.next_change(START + 100 * ms) is None


def test_making_an_agent_safe_that_has_arrived_takes_nothing_back() -> None:
    agent = world()
    give(agent, [(0, UP), (310 * ms, LEFT)])
    before = agent.values(START + second)
    assert before["arrived"]
    agent.make_safe(START + second)
    assert agent.values(START + second) == before
    assert agent.values(START + 2 * second) == before


def test_an_agent_that_has_arrived_takes_no_more_commands() -> None:
    agent = world()
    give(agent, [(0, UP), (310 * ms, LEFT)])
    before = agent.values(START + second)
    agent.command(START + second, {"move": UP})
    assert agent.values(START + 2 * second) == before


def test_a_new_episode_forgets_the_last_and_starts_somewhere_near_the_bottom() -> None:
    device = hallway(start=(0.05, 0.15))
    starts = []
    for seed in range(50):
        device.world.begin(START, np.random.default_rng(seed))
        values = device.world.values(START)
        starts.append(values["y"])
        assert values == {"x": WIDTH / 2, "y": values["y"], "wall_left": True, "arrived": False, "reward": 0.0}
        device.world.command(START, {"move": UP})
    assert 0.05 <= min(starts) < 0.07
    assert 0.13 < max(starts) <= 0.15
    assert len(set(starts)) == 50


# Step by step


def synchronous(step: float = 0.1) -> SynchronousHallwayWorld:
    made = SynchronousHallwayWorld(FLOOR, SPEED, step)
    made.begin(START, np.random.default_rng(0))
    return made


@given(st.lists(st.sampled_from([UP, LEFT]), max_size=20), st.lists(TIMES, min_size=1, max_size=4))
@settings(max_examples=100)
def test_a_synchronous_world_does_not_know_the_time(actions: list[int], times: list[int]) -> None:
    slow, fast = synchronous(), synchronous()
    for place, action in enumerate(actions):
        slow.command(START + place * second, {"move": action})
        fast.command(START, {"move": action})
    for time in times:
        assert slow.values(START + time) == fast.values(START)
    assert slow.next_change(START) is None
    assert list(slow.stimuli(0, START + second)) == []


def test_the_best_way_step_by_step_costs_the_seconds_of_its_steps() -> None:
    agent = synchronous()
    for action in [UP] * 6 + [LEFT] * 3:
        assert not agent.values(START)["arrived"]
        agent.command(START, {"move": action})
    values = agent.values(START)
    assert values["arrived"]
    # nine steps of 0.1 m at 2 m/s
    assert values["reward"] == pytest.approx(-9 * 0.05)
    agent.command(START, {"move": UP})
    assert agent.values(START) == values


def test_a_step_into_a_wall_costs_one_and_goes_up_to_it() -> None:
    agent = synchronous(step=0.08)
    rewards, places = [], []
    for action in (LEFT, LEFT, LEFT, UP):
        agent.command(START, {"move": action})
        rewards.append(agent.values(START)["reward"])
        places.append(agent.values(START)["x"])
    # 0.1 m to the wall: a whole step, a step that is cut short, and one that goes nowhere
    assert rewards == [0, -1, -2, -2]
    assert places == pytest.approx([0.02, 0, 0, 0])


# The task


def look(task: HallwayTask, place: World, time: int) -> Outcome:
    sample = Sample(place.values(START + time), START + time, START + time, time)
    return task.interpret(Observation(START + time, {"hallway": sample}))


@given(COMMANDS, st.lists(TIMES, max_size=12))
@settings(max_examples=100)
def test_the_rewards_of_an_episode_sum_to_what_it_cost_whenever_one_looks(
    commands: Commands, looks: list[int]
) -> None:
    agent, task = world(), HallwayTask()
    give(agent, commands)
    task.begin()
    rewards = [look(task, agent, time).reward for time in [*sorted(looks), 9 * second]]
    expected = Story(commands).values(9 * second)
    if not on_the_edge(expected):
        assert sum(rewards) == pytest.approx(expected["reward"], abs=1e-7)


def test_the_task_shows_the_wall_and_ends_at_the_goal() -> None:
    agent, task = world(), HallwayTask()
    task.begin()
    agent.command(START, task.commands(UP)["hallway"])
    assert look(task, agent, 299 * ms) == ((1.0,), 0.0, False, False)
    assert look(task, agent, 301 * ms) == ((0.0,), 0.0, False, False)
    agent.command(START + 301 * ms, task.commands(LEFT)["hallway"])
    outcome = look(task, agent, 452 * ms)
    assert outcome.terminated
    assert outcome.reward == pytest.approx(-0.451)
    assert [task.answers(action, Stimulus(0)) for action in (UP, LEFT)] == [False, True]
    assert task.state == {"wall_left": Spec.flag()}
    assert list(task.actions) == ["up", "left"]


def test_a_task_counts_the_rewards_of_an_episode_from_its_beginning() -> None:
    task = HallwayTask()
    for _ in range(2):
        agent = world()
        give(agent, [(0, LEFT)])
        task.begin()
        assert look(task, agent, 200 * ms).reward == -1.0


def test_the_task_refuses_devices_that_do_not_have_what_it_needs() -> None:
    HallwayTask().bind({"hallway": hallway().spec})
    HallwayTask(hallway="corridor").bind({"corridor": hallway(synchronous=True).spec})
    with pytest.raises(SpecError, match="'hallway'"):
        HallwayTask().bind({})


def test_a_hallway_says_whether_it_is_synchronous() -> None:
    assert hallway(synchronous=True).spec.synchronous
    assert not hallway().spec.synchronous


@pytest.mark.parametrize(
    "settings",
    [
        {"length": 0.0},
        {"speed": -1.0},
        {"step": 0.0},
        {"opening": 1.0},
        {"start": (0.5, 0.4)},
        {"start": (0.1, 0.7)},
    ],
)
def test_a_hallway_that_makes_no_sense_is_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SpecError):
        hallway(**settings)  # type: ignore[arg-type]  # the names are those of its parameters
