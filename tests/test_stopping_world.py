"""The stopping task's joint, and the task itself."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import pi

import numpy as np
import pytest
from helpers import read_in_any_order, visible
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rtagent import Observation, Sample, Spec, Stimulus, ms, second
from rtagent.errors import SpecError
from rtagent.experience import Outcome
from rtagent.tasks import Stopping
from rtagent_drivers.stopping import MOVE, STOP, StoppingWorld, stopping_joint

START = 10**15
TRAVEL, VELOCITY = 3.0, 1.0
END = START + 3 * second
EVENTS = ("emergency", "stopped", "at_end")


def world(seed: int = 0, onset: tuple[int, int] = (500 * ms, 1500 * ms), unit: int = second) -> StoppingWorld:
    made = StoppingWorld(TRAVEL, VELOCITY, onset, unit)
    made.begin(START, np.random.default_rng(seed))
    return made


def with_onset(onset: int) -> StoppingWorld:
    """Return a world whose Emergency begins `onset` after its start."""
    return world(onset=(onset, onset))


COMMANDS = st.lists(
    st.tuples(st.integers(0, 4 * second), st.sampled_from([MOVE, STOP, None])), max_size=8
)  # (when, motion), or None for being made safe
ONSETS = st.integers(0, 2_900 * ms)


def give(joint: StoppingWorld, commands: list[tuple[int, int | None]]) -> None:
    for when, motion in sorted(commands, key=lambda command: command[0]):
        if motion is None:
            joint.make_safe(START + when)
        else:
            joint.command(START + when, {"motion": motion})


def story(onset: int, commands: list[tuple[int, int | None]], time: int) -> dict[str, float | bool]:
    """Tell from the rules of the task what the sensors show `time` after the start."""
    end, stop, reward = 3 * second, None, 0.0
    for when, motion in sorted(commands, key=lambda command: command[0]):
        if when > time or when >= end or stop is not None:
            continue
        if motion is None or (motion == STOP and when >= onset):
            stop = when
        elif motion == STOP:
            reward -= 1.0
    rest = min(time, end if stop is None else stop)
    return {
        "position": rest / second * VELOCITY,
        "velocity": VELOCITY if rest == time and time < end and stop != time else 0.0,
        "stopped": stop is not None,
        "at_end": stop is None and time >= end,
        "reward": reward - max(0, rest - onset) / second,
    }


@given(ONSETS, COMMANDS, st.integers(0, 4 * second))
@settings(max_examples=300)
def test_the_sensors_show_what_the_rules_of_the_task_say(
    onset: int, commands: list[tuple[int, int | None]], time: int
) -> None:
    joint = with_onset(onset)
    give(joint, commands)
    values = dict(joint.values(START + time))
    emergency = values.pop("emergency")
    assert values == pytest.approx(story(onset, commands, time))
    if not values["stopped"]:
        assert emergency == (time >= onset)
    for name, value in joint.values(START + time).items():
        assert joint.spec.sensors[name].problem(value) is None


@given(ONSETS, COMMANDS, st.lists(st.integers(0, 4 * second), max_size=12), st.integers(0, 99))
@settings(max_examples=100)
def test_what_is_read_at_a_time_does_not_depend_on_the_order_of_reading(
    onset: int, commands: list[tuple[int, int | None]], times: list[int], seed: int
) -> None:
    joint = with_onset(onset)
    give(joint, commands)
    moments = [START + time for time in times]
    for first, again in read_in_any_order(joint.values, moments, np.random.default_rng(seed)):
        assert first == again


@given(ONSETS, COMMANDS, st.integers(0, 4 * second), st.integers(0, 4 * second))
@settings(max_examples=100)
def test_a_command_changes_nothing_of_the_past(
    onset: int, commands: list[tuple[int, int | None]], time: int, later: int
) -> None:
    joint = with_onset(onset)
    earlier = [command for command in commands if command[0] <= time]
    give(joint, earlier)
    before = joint.values(START + time)
    give(joint, [(max(when, time + 1 + later), motion) for when, motion in commands])
    assert joint.values(START + time) == before


@given(ONSETS, COMMANDS, st.integers(0, 4 * second), st.integers(0, 4 * second))
@settings(max_examples=200)
def test_nothing_happens_before_the_next_change(
    onset: int, commands: list[tuple[int, int | None]], first: int, second_: int
) -> None:
    joint = with_onset(onset)
    give(joint, commands)
    now, later = START + max([first, *(when for when, _ in commands)]), START + second_ + 5 * second
    change = joint.next_change(now)
    assert change is None or change > now
    until = later if change is None else change - 1
    assert visible(joint.values(until), EVENTS) == visible(joint.values(now), EVENTS)
    if change is not None:
        assert visible(joint.values(change), EVENTS) != visible(joint.values(now), EVENTS)


@given(ONSETS, COMMANDS, st.lists(st.integers(-1, 4 * second), max_size=10))
@settings(max_examples=100)
def test_every_stimulus_is_seen_once_whenever_one_looks(
    onset: int, commands: list[tuple[int, int | None]], looks: list[int]
) -> None:
    joint = with_onset(onset)
    give(joint, commands)
    times = [START - 1, *(START + look for look in sorted(looks)), START + 5 * second]
    seen = [s for after, until in pairwise(times) for s in joint.stimuli(after, until)]
    rests = story(onset, commands, 5 * second)["position"]
    expected = [Stimulus(START + onset, "emergency")] if rests >= onset / second else []
    assert seen == expected


def test_emergency_begins_at_its_true_time_and_not_a_nanosecond_earlier() -> None:
    joint = with_onset(700 * ms)
    onset = START + 700 * ms
    assert not joint.values(onset - 1)["emergency"]
    assert joint.values(onset)["emergency"]
    assert list(joint.stimuli(onset - 1, onset)) == [Stimulus(onset, "emergency")]
    assert list(joint.stimuli(onset, onset + second)) == []


def test_the_thesis_counts_microseconds_in_emergency() -> None:
    joint = StoppingWorld(TRAVEL, VELOCITY, (700 * ms, 700 * ms), 1000)
    joint.begin(START, np.random.default_rng(0))
    joint.command(START + 600 * ms, {"motion": STOP})
    joint.command(START + 750 * ms, {"motion": STOP})
    # -1 for the needless stop, and 50 ms = 50,000 µs of Emergency
    assert joint.values(START + second)["reward"] == pytest.approx(-1 - 50_000)


def test_onsets_are_uniform_and_belong_to_the_stream_of_the_episode() -> None:
    onsets = []
    joint = stopping_joint().world
    for seed in range(400):
        joint.begin(START, np.random.default_rng(seed))
        (stimulus,) = joint.stimuli(START, END)
        onsets.append((stimulus.time - START) / ms)
    assert stats.kstest(onsets, "uniform", args=(500, 1000)).pvalue > 1e-4
    assert world(3).next_change(START) == world(3).next_change(START) != world(4).next_change(START)


def test_a_new_episode_forgets_the_last() -> None:
    joint = with_onset(700 * ms)
    give(joint, [(100 * ms, STOP), (900 * ms, STOP)])
    joint.begin(END, np.random.default_rng(0))
    values = joint.values(END)
    assert values == with_onset(700 * ms).values(START)


@given(ONSETS, COMMANDS, st.lists(st.integers(0, 5 * second), max_size=15))
@settings(max_examples=100)
def test_the_rewards_of_an_episode_sum_to_what_it_cost_whenever_one_looks(
    onset: int, commands: list[tuple[int, int | None]], looks: list[int]
) -> None:
    joint, task = with_onset(onset), Stopping()
    give(joint, commands)
    task.begin()
    rewards = [look(task, joint, time).reward for time in [*sorted(looks), 6 * second]]
    assert sum(rewards) == pytest.approx(story(onset, commands, 6 * second)["reward"])


def look(task: Stopping, joint: StoppingWorld, time: int) -> Outcome:
    sample = Sample(joint.values(START + time), START + time, START + time, time)
    return task.interpret(Observation(START + time, {"joint": sample}))


def test_the_task_shows_the_emergency_and_ends_with_the_joint_at_rest() -> None:
    joint, task = with_onset(700 * ms), Stopping()
    task.begin()
    assert look(task, joint, 699 * ms) == ((0.0,), 0.0, False, False)
    assert look(task, joint, 750 * ms)[0] == (1.0,)
    joint.command(START + 800 * ms, task.commands(STOP)["joint"])
    outcome = look(task, joint, 900 * ms)
    assert outcome.terminated
    assert outcome.reward == pytest.approx(-0.05)
    assert [task.answers(action, Stimulus(0)) for action in (MOVE, STOP)] == [False, True]
    assert list(task.actions) == ["move", "stop"]
    assert task.state == {"emergency": Spec.flag()}


def test_a_task_counts_the_rewards_of_an_episode_from_its_beginning() -> None:
    task = Stopping()
    for _ in range(2):
        joint = with_onset(700 * ms)
        give(joint, [(100 * ms, STOP)])
        task.begin()
        assert look(task, joint, 200 * ms).reward == -1.0


def test_the_task_refuses_devices_that_do_not_have_what_it_needs() -> None:
    joint = stopping_joint()
    Stopping().bind({"joint": joint.spec})
    Stopping(joint="elbow").bind({"elbow": joint.spec})
    with pytest.raises(SpecError, match="device named 'joint'; the scenario has arm"):
        Stopping().bind({"arm": joint.spec})


@pytest.mark.parametrize(("kind", "name"), [("sensors", "stopped"), ("actuators", "motion")])
def test_the_task_names_the_signal_that_a_device_lacks(kind: str, name: str) -> None:
    spec = stopping_joint().spec
    lacking = replace(spec, **{kind: {key: value for key, value in getattr(spec, kind).items() if key != name}})
    with pytest.raises(SpecError, match=f"the {kind[:-1]} '{name}' of device 'joint', which has"):
        Stopping().bind({"joint": lacking})


def test_the_joint_of_the_thesis_turns_300_degrees_at_100_degrees_a_second() -> None:
    joint = stopping_joint()
    joint.world.begin(START, np.random.default_rng(0))
    assert joint.world.values(START + second)["position"] == pytest.approx(100 / 180 * pi)
    assert not joint.world.values(START + 2999 * ms)["at_end"]
    assert joint.world.values(START + 3001 * ms)["at_end"]
    assert joint.world.values(START + 9 * second)["position"] == pytest.approx(300 / 180 * pi)


@pytest.mark.parametrize(
    "settings",
    [
        {"travel": 0.0},
        {"velocity": -1.0},
        {"reward_unit": 0},
        {"onset": (2, 1)},
        {"onset": (-1, 1)},
        {"onset": (0, 3 * second)},
    ],
)
def test_a_joint_that_makes_no_sense_is_refused(settings: dict[str, float]) -> None:
    with pytest.raises(SpecError):
        stopping_joint(**settings)  # type: ignore[arg-type]  # the names are those of its parameters
