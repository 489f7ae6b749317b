"""A run that goes on from a checkpoint is the run that never stopped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from keeping import KeepsAll, all_of, learned, plain, run_scenario
from parts import run_stopping, sarsa_agent

from rtagent import Agent, ms, second
from rtagent.checkpoint.file import read, write
from rtagent.checkpoint.keeper import Keeper, Rules
from rtagent.device import Device
from rtagent.errors import CheckpointError, SpecError
from rtagent.features import Tabular
from rtagent.learning import QLearning, Sarsa
from rtagent.policy import Greedy
from rtagent.tasks import Stopping
from rtagent_drivers.fake import FakeDevice
from rtagent_drivers.stopping import StoppingWorld, stopping_joint

pytestmark = pytest.mark.slow

PRESETS = ["standard", "reactive", "deferred", "interruptible", "background", "learned"]
SAMPLED = 'devices.joint.sampling={rate="100Hz",delay="3ms",jitter="5ms"}'
FAULTS = 'devices.joint.faults={drop=0.1,duplicate=0.1,late=0.1,lateness="30ms"}'
COSTS = (
    'costs={act="1ms",observe={distribution="uniform",low="1us",high="900us"},'
    'learn={distribution="exponential",high="3ms"}}'
)
EXPLORES = ["policy.type=epsilon_greedy", "policy.epsilon=0.3"]
EVENT = 'devices.joint.events={far={signal="position",above=1.0}}'
SEEDS = st.integers(0, 99)
VARIANTS: list[list[str]] = [
    [],
    EXPLORES,
    [SAMPLED, FAULTS],
    [SAMPLED, COSTS, "schedule.learn_delay=7ms", *EXPLORES],
    ["schedule.period=20ms", "schedule.learn_delay=11ms"],
    [EVENT, "learn.queue=2", "schedule.learn_delay=90ms"],
]
HORDE = ["horde.demons.0.bins=2", "horde.features.prototypes=60", "devices.arm.joints=2", "run.episodes=3"]
WORLDS = [
    ("stopping", ["run.episodes=3", "run.trials=2"]),
    ("stopping_horde", HORDE),
]
SMALL = ["devices.webcam.width=64", "devices.webcam.height=48", "devices.glove.rate=100Hz"]
OTHERS = [
    ("hallway", ["run.episodes=4", "run.trials=2"]),
    ("hallway", ["run.episodes=2", "schedule.preset=interruptible", "learner.type=true_online_sarsa"]),
    ("cartpole", ["run.episodes=3", "schedule.preset=background"]),
    ("stopping_horde", [*HORDE, "schedule.preset=deferred", "schedule.period=20ms", "schedule.learn_delay=11ms"]),
    ("grasp_recording", ["run.fake=process", "run.episode_time=1s", "features.prototypes=100", *SMALL]),
    ("bento_stopping", ["run.fake=process", "run.episodes=3"]),
    ("hallway_synchronous", ["run.episodes=6", "learner.type=q_learning"]),
    ("predict", ["devices.arm.arm.duration=8s", "features.prototypes=60", "learner.measured=5"]),
    (
        "predict",
        [
            "devices.arm.arm.duration=8s",
            "features={type='binned',bins=2}",
            "learner={type='swift_td'}",
            "task.reward='arm.hand_load'",
            "task.signals=['arm.elbow_*']",
        ],
    ),
    ("phases", ["run.episode_time=4s", "learn.queue=2"]),
    ("phases_stopping", ["run.episodes=2"]),
    ("horde", ["run.episode_time=300ms", "features.prototypes=60", "run.episodes=2", "learner.rupee=true"]),
]


def check_resumed(name: str, overrides: list[str], part: float, folder: Path) -> None:
    """Keep a run after a part of its steps, go on with it, and compare both with the run that never stopped."""
    whole = run_scenario(name, overrides)
    step = max(1, int(part * sum(episode.steps for episode in whole.episodes)))
    keeper = KeepsAll(folder, Rules(step=step, episodes=2))
    assert all_of(run_scenario(name, overrides, keeper)) == all_of(whole), "keeping it changed it"
    checkpoints = keeper.checkpoints()
    assert any(checkpoint.saved["place"]["open"] for checkpoint in checkpoints) or part > 0.9
    for checkpoint in checkpoints:
        rest = KeepsAll(folder, Rules(episodes=0), checkpoint)
        assert all_of(run_scenario(name, overrides, rest)) == all_of(whole), checkpoint.saved["place"]


@st.composite
def runs(draw: st.DrawFn) -> tuple[str, list[str], float]:
    """Draw a scenario, what is set in it, and after which part of its steps it is kept."""
    name, own = draw(st.sampled_from(WORLDS))
    preset, variant = draw(st.sampled_from(PRESETS)), draw(st.sampled_from(VARIANTS))
    return name, [*own, f"schedule.preset={preset}", f"run.seed={draw(SEEDS)}", *variant], draw(st.floats(0, 1))


@settings(max_examples=2, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(run=runs())
def test_the_rest_of_a_run_is_the_same_to_the_byte_wherever_it_was_kept(
    run: tuple[str, list[str], float], tmp_path_factory: pytest.TempPathFactory
) -> None:
    check_resumed(*run, tmp_path_factory.mktemp("kept"))


WATCHED_LATE = ["schedule.preset=learned", "run.seed=12", "schedule.period=20ms", "schedule.learn_delay=11ms"]
"""A sample is waited for from the end of a cycle on, and arrives when the next one begins."""


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@example(run=("stopping_horde", [*HORDE, *WATCHED_LATE], 0.0))
@given(run=runs())
def test_so_it_is_with_many_more_runs(
    run: tuple[str, list[str], float], tmp_path_factory: pytest.TempPathFactory
) -> None:
    check_resumed(*run, tmp_path_factory.mktemp("kept"))


@pytest.mark.parametrize(("name", "overrides"), OTHERS)
def test_so_it_is_with_other_worlds_and_learners(name: str, overrides: list[str], tmp_path: Path) -> None:
    check_resumed(name, overrides, 0.6, tmp_path)


def test_more_episodes_than_before_are_those_that_would_have_followed(tmp_path: Path) -> None:
    keeper = KeepsAll(tmp_path, Rules(episodes=0))
    run_scenario("stopping", ["run.episodes=3", "schedule.preset=background"], keeper)
    (last,) = keeper.checkpoints()
    more = ["run.episodes=6", "schedule.preset=background"]
    assert all_of(run_scenario("stopping", more, KeepsAll(tmp_path, Rules(), last))) == all_of(
        run_scenario("stopping", more)
    )


def test_under_the_real_clock_what_was_learned_goes_on(tmp_path: Path) -> None:
    episodes = [f"run.episodes={number}" for number in (5, 12)]
    keeper = KeepsAll(tmp_path, Rules(episodes=0))
    run_scenario("hallway_synchronous", episodes[:1], keeper, "real")
    (last,) = keeper.checkpoints()
    resumed = run_scenario("hallway_synchronous", episodes[1:], KeepsAll(tmp_path, Rules(episodes=0), last), "real")
    whole = run_scenario("hallway_synchronous", episodes[1:], None, "real")
    assert learned(resumed.agents[0]) == learned(whole.agents[0])
    assert [each.steps for each in resumed.episodes] == [each.steps for each in whole.episodes]
    assert last.saved["world"] is None


@pytest.mark.parametrize("preset", ["reactive", "interruptible", "background"])
def test_under_the_real_clock_a_broken_off_episode_is_followed_by_the_next(preset: str, tmp_path: Path) -> None:
    overrides = ["run.episodes=3", f"schedule.preset={preset}", "schedule.learn_delay=1ms"]
    keeper = KeepsAll(tmp_path, Rules(step=5, episodes=0))
    run_scenario("hallway_synchronous", overrides, keeper, "real")
    checkpoint = next(each for each in keeper.checkpoints() if each.saved["place"]["open"])
    begun = checkpoint.saved["place"]["episodes"]
    result = run_scenario("hallway_synchronous", overrides, KeepsAll(tmp_path, Rules(), checkpoint), "real")
    assert [episode.finished for episode in result.episodes] == [True] * (begun - 1) + [False] + [True] * (
        3 - begun
    )
    assert np.isfinite(result.agents[0].learner.weights).all()  # type: ignore[union-attr]  # tabular


def test_an_agent_that_cannot_be_saved_is_told_before_anything_is_opened(tmp_path: Path) -> None:
    class Forgetful(Sarsa):
        save = None  # type: ignore[assignment]

    def make(rng: np.random.Generator) -> Agent:
        features = Tabular(state=Stopping().state)
        return Agent(features, Forgetful(size=features.size, actions=2), Greedy(), rng)

    with pytest.raises(SpecError, match="Forgetful remembers and cannot be saved: give it save and restore"):
        run_stopping(agent=make, joint=never_opened(), keeper=Keeper(tmp_path / "a.ckpt"))


def never_opened() -> Device:
    joint = stopping_joint()

    async def never() -> None:
        raise AssertionError("it was opened")

    joint.open = never  # type: ignore[method-assign]  # a trap
    return joint


class Unsaved(StoppingWorld):
    """A world of a user's who has not heard of checkpoints."""

    save = None  # type: ignore[assignment]


def unsaved() -> FakeDevice:
    return FakeDevice(Unsaved(5.0, 2.0, (500 * ms, 1500 * ms), second))


def test_a_world_that_cannot_be_saved_within_an_episode_is_told_once(tmp_path: Path) -> None:
    result = run_stopping(joint=unsaved(), keeper=Keeper(tmp_path / "a.ckpt", Rules(every=10 * ms)))
    (fault,) = result.faults
    assert fault.count == 1
    assert fault.message.startswith("no checkpoint is kept in the middle of an episode: Unsaved cannot be saved")
    assert result.episodes[-1].finished


def test_with_such_a_world_a_run_goes_on_with_the_next_episode(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    run_stopping(episodes=3, joint=unsaved(), keeper=Keeper(path))
    assert read(path).saved["world"] is None
    resumed = run_stopping(episodes=6, joint=unsaved(), keeper=Keeper(path, resumed=read(path)))
    whole = run_stopping(episodes=6, joint=unsaved())
    assert [each.total_reward for each in resumed.episodes] == [each.total_reward for each in whole.episodes]
    assert learned(resumed.agents[0]) == learned(whole.agents[0])


def test_a_disk_that_takes_nothing_is_a_fault_and_the_run_goes_on(tmp_path: Path) -> None:
    keeper = Keeper(tmp_path / "gone" / "a.ckpt", Rules(step=3))
    result = run_stopping(keeper=keeper)
    assert {fault.message.split(":")[0] for fault in result.faults} == {
        "the checkpoint before stays, if there is one"
    }
    assert result.episodes[-1].finished


def test_the_checkpoint_of_another_agent_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    run_stopping(keeper=Keeper(path))

    def other(rng: np.random.Generator) -> Agent:
        return Agent(Tabular(state=Stopping().state), Sarsa(size=2, actions=3), Greedy(), rng)

    with pytest.raises(CheckpointError, match=r"does not fit this run: .*not float64 of shape \(3, 2\)"):
        run_stopping(agent=other, joint=never_opened(), keeper=Keeper(path, resumed=read(path)))


def test_an_agent_takes_all_of_a_state_or_nothing() -> None:
    agent, other = (sarsa_agent(Stopping())(np.random.default_rng(seed)) for seed in (1, 2))
    saved = agent.save()
    saved["parts"]["learner"]["trace"] = np.zeros(5)
    other.learner.restore(other.learner.save() | {"weights": np.ones((2, 2))})  # type: ignore[union-attr]
    before = plain(other.save())
    with pytest.raises(SpecError):
        other.restore(saved)
    assert plain(other.save()) == before


def test_a_state_without_one_of_its_parts_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    run_stopping(keeper=Keeper(path))
    saved = read(path).saved
    for part in ("agents", "recorder", "runtime", "place", "world", "age"):
        write(path, {}, {name: value for name, value in saved.items() if name != part})
        with pytest.raises(CheckpointError, match="does not fit this run"):
            run_stopping(keeper=Keeper(path, resumed=read(path)))


def test_a_run_of_fewer_trials_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    run_stopping(trials=2, keeper=Keeper(path))
    with pytest.raises(CheckpointError, match="is of trial 2, and this run has 1"):
        run_stopping(trials=1, keeper=Keeper(path, resumed=read(path)))


def test_another_learner_is_refused_through_its_state(tmp_path: Path) -> None:
    path = tmp_path / "a.ckpt"
    run_stopping(keeper=Keeper(path))

    def q(rng: np.random.Generator) -> Agent:
        return Agent(Tabular(state=Stopping().state), QLearning(size=7, actions=2), Greedy(), rng)

    with pytest.raises(CheckpointError):
        run_stopping(agent=q, keeper=Keeper(path, resumed=read(path)))
