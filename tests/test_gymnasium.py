"""Gymnasium environments as worlds: each sensor against a plain loop, each run against the textbook's loop."""

from __future__ import annotations

import asyncio
import gc
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from helpers import read_in_any_order, virtually
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import SCENARIOS
from test_equivalence import Learned
from test_presets import counted

from rtagent import Observation, Sample, Spec, Transition, clock, ms, second
from rtagent.__main__ import main
from rtagent.clock import current
from rtagent.errors import DeviceError, PluginError, RtagentError, SpecError
from rtagent.experience import FloatArray, Values
from rtagent.scenario import assemble, load
from rtagent.schedule import PRESETS
from rtagent.streams import stream
from rtagent.task import Task, Urging
from rtagent.tasks import EnvironmentTask
from rtagent.testing import DeviceContract
from rtagent_drivers.fake import FakeDevice, Faults, Sampling, World
from rtagent_drivers.gym import KEPT, gymnasium_world

START, STEP = 10**15, 20 * ms


class Counter(gymnasium.Env[Any, Any]):
    """Counts its steps, and keeps its last action; `ends` says after which step, and how."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}
    closed: ClassVar[list[int]] = []
    reset_until: ClassVar[list[int]] = []

    def __init__(
        self, ends: tuple[int, bool, bool] = (10**9, True, False), space: Any = None, number: int = 0
    ) -> None:
        self.observation_space = space or gymnasium.spaces.Box(0.0, np.inf, (2,), np.float64)
        self.action_space = gymnasium.spaces.Discrete(2, start=5)
        self._ends, self._number = ends, number

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        time.sleep(0.003)
        self._steps = 0
        Counter.reset_until.append(time.monotonic_ns())
        return np.array([0.0, 0.0]), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._steps += 1
        last, terminated, truncated = self._ends
        over = self._steps >= last
        return np.array([self._steps, action]), 0.5, over and terminated, over and truncated, {}

    def close(self) -> None:
        Counter.closed.append(self._number)


@pytest.fixture(autouse=True, scope="module")
def _counter() -> Iterator[None]:
    gymnasium.register("rtagent/Counter-v0", Counter)
    yield
    del gymnasium.registry["rtagent/Counter-v0"]


def counter(step: int = STEP, sampling: Sampling | None = None, **arguments: Any) -> FakeDevice:
    return gymnasium_world(environment="rtagent/Counter-v0", step=step, sampling=sampling, arguments=arguments)


def begun(device: FakeDevice, seed: int = 0) -> World:
    world: Any = device.world
    world.prepare(np.random.default_rng(seed))
    world.begin(START, np.random.default_rng(seed))
    return world  # type: ignore[no-any-return]  # it is one


# In a run: against a plain loop


def plain_loop(
    name: str, agent: Any, ranges: Sequence[tuple[float, float]], *, seed: int, episodes: int, limit: int
) -> tuple[list[tuple[object, ...]], FloatArray]:
    """Learn as any Gymnasium user would; only coder, learner and policy are ours. Return what was learned."""
    environment, journal = gymnasium.make(name, max_episode_steps=limit), Learned()

    def seen(observation: Any) -> Any:
        numbers = observation.astype(float)
        return agent.features.encode(tuple(np.clip(numbers, *zip(*ranges, strict=True)) if ranges else numbers))

    def chosen(features: Any) -> tuple[int, float]:
        choice: tuple[int, float] = agent.policy.choose(agent.learner.action_values(features), agent.rng)
        return choice

    for episode in range(episodes):
        rng = stream(seed, "device", "environment", 0, episode)
        features = seen(environment.reset(seed=int(rng.integers(2**31)))[0])
        (action, probability), over = chosen(features), False
        while not over:
            observation, reward, terminated, truncated, _ = environment.step(action)
            following, over = seen(observation), terminated or truncated
            after = (None, 0.0) if terminated else chosen(following)
            known = (features, action, probability, float(reward), following, after[0], 0)
            transition = Transition(*known, terminated, truncated and not terminated)
            journal.learned(transition, agent.learner.update(transition), 0)
            features, (action, probability) = following, after  # type: ignore[assignment]  # None is the last
    return journal.transitions, agent.learner.weights


LIMITS = {"cartpole": (12, 80), "mountain_car": (2, 1200), "acrobot": (2, 650)}
"""Episodes, and their most steps: so that some are terminated and some truncated."""


@pytest.mark.slow
@pytest.mark.parametrize("scenario", LIMITS)
def test_what_takes_no_time_learns_what_a_plain_loop_does_bit_for_bit(scenario: str) -> None:
    episodes, limit = LIMITS[scenario]
    free = ["run.clock=virtual", "schedule.learn_delay=0ms", f"run.episodes={episodes}", "policy.epsilon=0.05"]
    free.append(f"devices.environment.arguments={{max_episode_steps={limit}}}")
    loaded = load(SCENARIOS / f"{scenario}.toml", free)
    driver = loaded.devices["environment"].given()
    ranges = list((driver.get("ranges") or {}).values())
    agent = assemble(loaded).make_agent(stream(1, "policy", 0))
    transitions, weights = plain_loop(driver["environment"], agent, ranges, seed=1, episodes=episodes, limit=limit)
    assert {transition[6:8] for transition in transitions} == {(False, False), (True, False), (False, True)}
    for preset, synchronous in (("standard", "true"), ("reactive", "true"), ("reactive", "false")):
        kind = [f"schedule.preset={preset}", f"devices.environment.synchronous={synchronous}"]
        assembly, journal = assemble(load(SCENARIOS / f"{scenario}.toml", [*free, *kind])), Learned()
        result = clock.run(assembly.run([journal]), "virtual")
        assert journal.transitions == transitions
        assert result.agents[0].learner.weights.tobytes() == weights.tobytes()  # type: ignore[union-attr]  # it has them


@pytest.mark.parametrize("clock_name", ["real", "virtual"])
@pytest.mark.parametrize("preset", PRESETS)
def test_all_three_run_under_every_preset_and_clock(preset: str, clock_name: clock.ClockName) -> None:
    for scenario in LIMITS:
        short = [
            "run.episodes=2",
            "run.episode_steps=6",
            "devices.environment.step=2ms",
            "schedule.learn_delay=1ms",
            "devices.environment.arguments={max_episode_steps=100000}",
        ]
        rules = [f"schedule.preset={preset}", f"run.clock={clock_name}"]
        result = clock.run(assemble(load(SCENARIOS / f"{scenario}.toml", [*short, *rules])).run(), clock_name)
        steps = [episode.steps for episode in result.episodes]
        if scenario == "cartpole":  # which may have fallen while a busy machine did something else
            assert all(count <= 6 for count in steps)
        else:
            assert steps == [6, 6]
        assert sum(counted(result).values()) == sum(steps)
        assert not result.recorder.faults


def test_an_agent_that_is_slower_than_the_world_sees_less_of_it() -> None:
    steps = {}
    for delay in ("0ms", "15ms", "60ms"):
        rules = [f"schedule.learn_delay={delay}", "run.episodes=1", "policy.epsilon=1.0", "run.clock=virtual"]
        result = clock.run(assemble(load(SCENARIOS / "cartpole.toml", rules)).run(), "virtual")
        episode = result.episodes[0]
        steps[delay] = episode.steps, episode.total_reward
    assert steps["0ms"] == steps["15ms"], "what takes less than a step of the world costs nothing"
    decisions, reward = steps["60ms"]
    assert reward >= 3 * decisions - 3, "each transition of 60 ms is three steps of 20 ms, and all their reward"


# The world as a function of time: against its steps one by one


class Story:
    """CartPole told by a loop: at the end of each step it is made under the last action that came before then."""

    def __init__(self, commands: Sequence[tuple[int, int]], seed: int = 0, steps: int = 130) -> None:
        environment = gymnasium.make("CartPole-v1")
        drawn = int(np.random.default_rng(seed).integers(2**31))
        self.frames = [self.frame(environment.reset(seed=drawn)[0], 0.0, False, False)]
        for number in range(1, steps + 1):
            before = [action for when, action in commands if when < number * STEP]
            observation, _, terminated, truncated, _ = environment.step(before[-1] if before else 0)
            self.frames.append(self.frame(observation, float(number), terminated, truncated))
            if terminated or truncated:
                break

    @staticmethod
    def frame(observation: Any, reward: float, terminated: bool, truncated: bool) -> Values:
        numbers = {f"observation_{place}": float(number) for place, number in enumerate(observation)}
        return numbers | {"reward": reward, "terminated": terminated, "truncated": truncated}

    def values(self, time: int) -> Values:
        return self.frames[min(time // STEP, len(self.frames) - 1)]


MOMENTS = st.integers(0, 60).map(lambda place: place * STEP // 2) | st.integers(0, 1200 * ms)
COMMANDS = st.lists(st.tuples(MOMENTS, st.integers(0, 1)), max_size=40).map(sorted)
CARTPOLE = gymnasium_world(environment="CartPole-v1")


@given(COMMANDS, st.lists(MOMENTS, min_size=1, max_size=20), st.integers(0, 9))
@settings(max_examples=40)
def test_the_sensors_show_the_steps_in_whatever_order_they_are_read(
    commands: list[tuple[int, int]], times: list[int], seed: int
) -> None:
    world, story = begun(CARTPOLE, seed), Story(commands, seed)
    early = min(times)
    for when, action in commands:
        if when >= early:  # before a command that comes later is known
            assert world.values(START + early) == story.values(early)
        world.command(START + when, {"action": action})
    moments = [START + time for time in times]
    for place, (first, again) in enumerate(read_in_any_order(world.values, moments, np.random.default_rng(seed))):
        assert first == again == story.values(times[place])
        for name, value in first.items():
            assert world.spec.sensors[name].problem(value) is None


@given(COMMANDS, MOMENTS, MOMENTS)
@settings(max_examples=30)
def test_the_next_change_is_the_end_of_a_step_until_all_is_over(
    commands: list[tuple[int, int]], now: int, looked: int
) -> None:
    world, story = begun(CARTPOLE), Story(commands)
    for when, action in commands:
        world.command(START + when, {"action": action})
    world.values(START + looked)
    change = world.next_change(START + now)
    following = now // STEP + 1
    assert change == (START + following * STEP if following < len(story.frames) else None)


@pytest.mark.parametrize("seed", range(4))
def test_samples_that_come_late_are_what_they_would_have_been(seed: int) -> None:
    device = gymnasium_world(
        environment="CartPole-v1",
        sampling=Sampling(rate=70.0, delay=35 * ms, jitter=50 * ms),
        faults=Faults(late=1.0, lateness=600 * ms, drop=0.1, duplicate=0.1),
    )
    rng, commands, samples = np.random.default_rng(seed), list[tuple[int, int]](), list[Sample]()

    async def act(began: int) -> None:
        while True:
            await asyncio.sleep(float(rng.uniform(0.001, 0.06)))
            commands.append((current().now() - began, int(rng.integers(2))))
            await device.act({"action": commands[-1][1]})

    async def live() -> int:
        await device.open()
        await device.begin_episode(np.random.default_rng(seed))
        began = current().now()
        acting = asyncio.ensure_future(act(began))
        while current().now() < began + 3 * second:
            samples.append(await device.read(samples[-1].sequence if samples else -1))
        acting.cancel()
        return began

    began = virtually(live())
    story = Story(commands, seed)
    assert len(samples) > 30
    assert max(sample.arrival_time - sample.world_time for sample in samples) > 600 * ms
    for sample in samples:
        assert sample.values == story.values(sample.world_time - began)


def test_each_sample_is_a_new_step_however_long_a_step_is() -> None:
    for step in (1, 7, 16_666_667, 33_333_333, 199_999_999):
        device = counter(step=step)

        async def read(device: FakeDevice = device) -> list[Values]:
            await device.open()
            last = await device.read(-1)
            samples = [last, *[last := await device.read(last.sequence) for _ in range(300)]]
            return [sample.values for sample in samples]

        assert [values["observation_0"] for values in virtually(read())] == list(range(301))


def test_what_was_so_is_kept_as_long_as_samples_may_need_it_and_then_forgotten() -> None:
    world, patient = begun(counter()), begun(counter(sampling=Sampling(rate=1.0, delay=100 * second)))
    for each, kept in ((world, KEPT), (patient, KEPT + 101 * second // STEP)):
        end = 3 * kept
        each.values(START + end * STEP)
        assert each.values(START + (end - kept) * STEP)["observation_0"] == end - kept
        with pytest.raises(DeviceError, match="forgotten"):
            each.values(START)


def test_numbers_outside_their_range_are_given_as_its_ends_and_what_is_no_number_stays() -> None:
    device = gymnasium_world(
        environment="rtagent/Counter-v0", step=STEP, ranges={"observation_0": (1.0, 3.0), "observation_1": (0, 9)}
    )
    assert device.spec.sensors["observation_0"] == Spec(low=1.0, high=3.0)
    world = begun(device)
    assert [world.values(START + place * STEP)["observation_0"] for place in range(5)] == [1.0, 1.0, 2.0, 3.0, 3.0]
    assert world.values(START + STEP)["observation_1"] == 5, "an action is handed over as the environment counts it"


# The beginning and the end


def test_an_episode_begins_when_the_reset_is_done() -> None:
    async def first() -> Sample:
        device = counter(step=second)
        await device.open()
        await device.begin_episode(np.random.default_rng(0))
        return await device.read(-1)

    sample = clock.run(first(), "real")
    assert sample.world_time >= Counter.reset_until[-1]
    assert sample.values["observation_0"] == 0


def test_an_environment_goes_on_while_its_device_is_closed_and_is_closed_when_nobody_has_it() -> None:
    Counter.closed.clear()

    async def interrupted() -> Values:
        device = counter(number=7)
        await device.open()
        await device.close()
        await asyncio.sleep(10 * STEP / second)
        await device.open()
        assert 7 not in Counter.closed
        return (await device.read(-1)).values

    assert virtually(interrupted())["observation_0"] == 10
    gc.collect()
    assert 7 in Counter.closed


def test_an_environment_that_is_refused_is_closed() -> None:
    Counter.closed.clear()
    with pytest.raises(SpecError):
        gymnasium_world(environment="rtagent/Counter-v0", arguments={"number": 8}, ranges={"no such": (0, 1)})
    gc.collect()
    assert 8 in Counter.closed


@pytest.mark.parametrize("synchronous", [True, False])
@pytest.mark.parametrize("how", [(True, False), (False, True), (True, True)])
def test_after_its_end_nothing_changes_and_terminated_goes_before_truncated(
    how: tuple[bool, bool], synchronous: bool
) -> None:
    settings = {"synchronous": True} if synchronous else {"step": STEP}
    device = gymnasium_world(environment="rtagent/Counter-v0", arguments={"ends": (3, *how)}, **settings)
    world, task = begun(device), EnvironmentTask()
    task.bind({"environment": device.spec})
    task.begin()
    outcomes = []
    for place in range(6):
        sample = Sample(world.values(START + place * STEP), START, START, place)
        outcomes.append(task.interpret(Observation(START, {"environment": sample})))
        world.command(START + place * STEP, {"action": 1})
    assert [outcome.state for outcome in outcomes[3:]] == [(3.0, 6.0)] * 3
    assert [outcome.reward for outcome in outcomes] == [0.0, 0.5, 0.5, 0.5, 0.0, 0.0]
    ends = [(outcome.terminated, outcome.truncated) for outcome in outcomes]
    assert ends == [(False, False)] * 3 + [(how[0], not how[0])] * 3


class TestCartPole(DeviceContract):
    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return gymnasium_world(environment="CartPole-v1", step=3 * ms)


class TestCartPoleInVirtualTime(TestCartPole):
    clock: clock.ClockName = "virtual"


class TestCartPoleAsOfNow(DeviceContract):
    clock: clock.ClockName = "virtual"

    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return gymnasium_world(environment="CartPole-v1", sampling=Sampling(delay=ms))


class TestSynchronousCartPole(DeviceContract):
    clock: clock.ClockName = "virtual"

    def make_device(self):  # type: ignore[no-untyped-def]  # as a user would write it
        return gymnasium_world(environment="CartPole-v1", synchronous=True)


# Spaces, and what does not fit


def test_the_actions_of_a_continuous_environment_are_those_that_are_given() -> None:
    device = gymnasium_world(environment="Pendulum-v1", actions=((-2.0,), (0.5,)), idle=1)
    assert device.spec.actuators["action"] == Spec.discrete(2)
    twin = gymnasium.make("Pendulum-v1")
    twin.reset(seed=int(np.random.default_rng(0).integers(2**31)))
    world = begun(device)
    for place, action in enumerate([0.5, -2.0, -2.0, 0.5]):
        observation, *_ = twin.step(np.array([action], dtype=np.float32))
        values = world.values(START + (place + 1) * 50 * ms)
        assert [values[f"observation_{number}"] for number in range(3)] == observation.tolist()
        world.command(START + (place + 1) * 50 * ms, {"action": int(place == 2)})


def test_a_state_that_is_counted_can_be_kept_in_a_table() -> None:
    device = gymnasium_world(environment="FrozenLake-v1", synchronous=True)
    assert device.spec.sensors["observation_0"] == Spec.discrete(16)
    world = begun(device)
    world.command(START, {"action": 1})
    assert isinstance(world.values(START)["observation_0"], int)


def test_what_gymnasium_warns_of_is_a_note_and_so_is_the_step() -> None:
    step, warning = gymnasium_world(environment="CartPole-v0").notes
    assert step == "a step takes 20 ms (its tau)"
    assert warning.startswith("The environment CartPole-v0 is out of date")
    assert gymnasium_world(environment="MountainCar-v0").notes == ["a step takes 33.3 ms (its render_fps)"]
    assert gymnasium_world(environment="Acrobot-v1").notes == ["a step takes 200 ms (its dt)"]
    assert gymnasium_world(environment="CartPole-v1", synchronous=True).notes == []


SPACES = gymnasium.spaces


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"environment": "CartPol-v1"}, "no environment 'CartPol-v1': did you mean 'CartPole-v1'?"),
        ({"environment": "Xyzzyxyzzy-v1"}, "pprint_registry"),
        ({"environment": "CartPole-v9"}, "cannot be made: .*`v0`, `v1`"),
        ({"environment": "a b"}, "cannot be made: Malformed"),
        ({"environment": "no_such_module:X-v0"}, "cannot be made: No module named 'no_such_module'"),
        ({"arguments": {"colour": 1}}, "cannot be made: .*colour"),
        ({"arguments": {"render_mode": "human"}}, "leave it out"),
        ({"step": -1}, "step is negative"),
        ({"idle": 2}, "idle is 2: give one of the 2 actions"),
        ({"idle": -1}, "idle is -1"),
        ({"ranges": {"observation_9": (0, 1)}}, "no 'observation_9': did you mean 'observation_"),
        ({"ranges": {"observation_1": (1, 0)}}, "empty"),
        ({"actions": ((1.0,),)}, "leave out actions"),
        ({"synchronous": True, "sampling": Sampling(rate=5.0)}, "leave out sampling"),
        ({"environment": "Pendulum-v1"}, "give actions"),
        ({"environment": "Pendulum-v1", "actions": ((2.5,),)}, r"\[2.5\] is none of its actions"),
        ({"environment": "Pendulum-v1", "actions": ((1.0, 1.0),)}, "none of its actions"),
        ({"environment": "Blackjack-v1"}, "a Box of numbers or a Discrete is needed; register"),
        ({"environment": "rtagent/Counter-v0"}, "give step a time"),
        ({"environment": "rtagent/Counter-v0", "arguments": {"space": SPACES.MultiBinary(3)}}, "FlattenObs"),
        ({"environment": "rtagent/Counter-v0", "arguments": {"space": SPACES.MultiDiscrete([3, 2])}}, "FlattenObs"),
        (
            {
                "environment": "rtagent/Counter-v0",
                "arguments": {"space": SPACES.Box(0, 255, (84, 84, 3), np.uint8)},
            },
            "21168 numbers",
        ),
        (
            {"environment": "rtagent/Counter-v0", "arguments": {"space": SPACES.Dict({"a": SPACES.Discrete(2)})}},
            "FlattenObs",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_a_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        gymnasium_world(**{"environment": "CartPole-v1"} | settings)


def test_an_action_space_that_cannot_be_numbered_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    class Buttons(Counter):
        def __init__(self) -> None:
            super().__init__()
            self.action_space = SPACES.MultiBinary(2)  # type: ignore[assignment]  # which is the point

    monkeypatch.setitem(
        gymnasium.registry, "Buttons-v0", gymnasium.envs.registration.EnvSpec("Buttons-v0", entry_point=Buttons)
    )
    with pytest.raises(SpecError, match="a Discrete or a Box is needed"):
        gymnasium_world(environment="Buttons-v0", step=STEP)


def test_without_the_package_a_sentence_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(PluginError, match=r"pip install 'rtagent\[gymnasium\]'"):
        gymnasium_world(environment="CartPole-v1")


def test_a_scenario_that_misspells_its_environment_says_where(tmp_path: Any) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text((SCENARIOS / "cartpole.toml").read_text().replace('"CartPole-v1"', '"CartPoel-v1"'))
    with pytest.raises(RtagentError, match=r"wrong.toml:\d+.*did you mean 'CartPole-v1'"):
        assemble(load(path))


@pytest.mark.parametrize(("timeout", "told"), [("100ms", True), ("200ms", False), ("1s", False)])
def test_check_tells_of_a_world_that_has_less_news_than_observe_has_patience(
    timeout: str, told: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    acrobot = ["check", str(SCENARIOS / "acrobot.toml"), "--set", f"schedule.observe_timeout={timeout}"]
    assert main(acrobot) == 0
    assert ("nothing new comes for 200 ms at a time" in capsys.readouterr().out) is told


def test_the_task_has_the_state_and_the_actions_of_its_environment() -> None:
    device = gymnasium_world(environment="MountainCar-v0")
    task: Task = EnvironmentTask(environment="car")
    task.bind({"car": device.spec})
    assert list(task.state) == ["observation_0", "observation_1"]
    assert list(task.actions) == ["0", "1", "2"]
    assert task.commands(2) == {"car": {"action": 2}}
    with pytest.raises(SpecError, match="'environment'"):
        EnvironmentTask().bind({"car": device.spec})


def test_the_task_is_urgent_outside_of_what_is_calm_and_says_nothing_where_that_is_not_said() -> None:
    calm = {"observation_0": (-1.0, 1.0), "observation_1": (0.0, 0.5)}
    task, spec = EnvironmentTask(calm=calm), gymnasium_world(environment="MountainCar-v0").spec
    task.bind({"environment": spec})
    assert isinstance(task, Urging)
    assert not isinstance(EnvironmentTask(), Urging)
    for values, urgent in (((0.0, 0.5), False), ((1.1, 0.2), True), ((1.0, -0.1), True), ((-1.0, 0.0), False)):
        sample = Sample({"observation_0": values[0], "observation_1": values[1]}, 0, 0, 0)
        assert task.urgent({"environment": sample}) is urgent
    with pytest.raises(SpecError, match=r"give \[lowest"):
        EnvironmentTask(calm={"observation_0": (1.0, 0.0)})
    with pytest.raises(SpecError, match="no 'observation_7': did you mean"):
        EnvironmentTask(calm={"observation_7": (0.0, 1.0)}).bind({"environment": spec})
