"""What is urgent: by the task, a signal, or a prediction; and what cannot be asked is told before a run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from parts import SCENARIOS, sarsa_agent
from test_presets import COSTS, Journal, counted
from test_scenario import line_of, problems

from rtagent import Agent, Limits, Plan, Result, Schedule, clock, ms, run, second
from rtagent.__main__ import main as command_line
from rtagent.errors import ScheduleError
from rtagent.experience import FeatureVector, FloatArray, Transition
from rtagent.features import Tabular
from rtagent.learn import Condition, Learn, When
from rtagent.learning import Sarsa
from rtagent.policy import Greedy
from rtagent.schedule import PRESETS, REACTIVE
from rtagent.tasks import HallwayTask, Stopping
from rtagent_drivers.fake import FakeDevice, Sampling
from rtagent_drivers.hallway import hallway
from rtagent_drivers.stopping import stopping_joint

STOPPING = (SCENARIOS / "stopping.toml").read_text().replace('preset = "reactive" ', 'preset = "deferred" ')


class Foreteller(Sarsa):
    """Predicts Emergency from its feature; asked for one prediction at a time."""

    names = ("calm soon", "emergency soon")

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.asked: list[str] = []

    def prediction(self, name: str, features: FeatureVector) -> float:
        self.asked.append(name)
        return float(features.indices[0] == 1)


class LearningTimes(Journal):
    """When each transition was learned, and which were observed then."""

    def __init__(self) -> None:
        super().__init__()
        self.times: list[int] = []

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        self.times.append(time)


def run_deferred(
    urgent: Condition | None,
    *,
    task: Stopping | None = None,
    joint: FakeDevice | None = None,
    learner: type[Sarsa] = Sarsa,
    delay: int = 20 * ms,
    slice: int = 0,  # noqa: A002  # as the setting is called
) -> tuple[Result, LearningTimes]:
    """Run the stopping task with an agent that never stops, so that Emergency lasts."""
    task, times = task or Stopping(), LearningTimes()

    class Idle(Greedy):
        def choose(self, values: FloatArray, rng: object) -> tuple[int, float]:
            return 0, 1.0

    def make(rng: Any) -> Agent:
        return Agent(Tabular(state=task.state), learner(size=2, actions=2), Idle(), rng)

    async def main() -> Result:
        rules = Learn(when=When.CALM, urgent=urgent, slice=slice)
        schedule = Schedule(REACTIVE, learn=rules, learn_delay=delay)
        devices = {"joint": joint or stopping_joint(sampling=Sampling(rate=50.0))}
        return await run(devices, task, make, schedule, Plan(episodes=3), costs=COSTS, instruments=[times])

    return clock.run(main(), "virtual"), times


def learned_while(result: Result, times: LearningTimes, urgent: Any, *, at_least: int = 10) -> int:
    """Count what was learned while the newest observation was urgent, by a function of the joint's values."""
    seen = [(each.time, urgent(each.samples["joint"].values)) for each in times.observations]
    assert sum(value for _, value in seen) >= at_least
    found = 0
    for time in times.times:
        if time > times.observations[-1].time:
            break  # the rest is learned when all is over
        before = [value for at, value in seen if at < time]
        found += bool(before) and before[-1]
    return found


def is_emergency(values: Mapping[str, Any]) -> bool:
    return bool(values["emergency"]) and not values["stopped"]


@pytest.mark.parametrize("rate", [0.0, 50.0])
@pytest.mark.parametrize("slice_", [0, ms])
def test_the_task_says_what_is_urgent(rate: float, slice_: int) -> None:
    joint = stopping_joint(sampling=Sampling(rate=rate))
    result, times = run_deferred(None, joint=joint, slice=slice_, delay=15 * ms)
    urgent = [is_emergency(each.samples["joint"].values) for each in times.observations]
    assert any(urgent)
    assert counted(result)["learned_deferred"] > 0
    assert learned_while(result, times, is_emergency, at_least=3) <= 3, "at most what the end of an episode learned"


def test_a_signal_says_what_is_urgent() -> None:
    result, times = run_deferred(Condition(signal="joint.position", above=2.0))
    assert learned_while(result, times, lambda values: values["position"] > 2.0) == 0
    assert counted(result)["learned_deferred"] > 100
    assert sum(counted(result).values()) == sum(each.steps for each in result.episodes)


def test_below_is_urgent_too() -> None:
    result, times = run_deferred(Condition(signal="joint.position", below=1.0))
    assert learned_while(result, times, lambda values: values["position"] < 1.0) == 0


def test_a_prediction_says_what_is_urgent_and_no_other_is_asked_for() -> None:
    result, times = run_deferred(Condition(prediction="emergency soon", above=0.5), learner=Foreteller)
    assert learned_while(result, times, is_emergency) == 0
    learner = result.agents[0].learner
    assert isinstance(learner, Foreteller)
    assert set(learner.asked) == {"emergency soon"}


def test_who_waits_for_a_prediction_looks_at_the_world_while_it_catches_up() -> None:
    _, times = run_deferred(Condition(prediction="emergency soon", above=0.5), learner=Foreteller, delay=100 * ms)
    ages = [each.age("joint") for each in times.observations]
    assert max(ages) <= 20 * ms
    gaps = [
        after.time - before.time for before, after in zip(times.observations, times.observations[1:], strict=False)
    ]
    assert max(gaps) <= 130 * ms, "an update, and the wait for a sample"


@pytest.mark.parametrize("above", [1.0, -1.0])
def test_a_bound_is_not_urgent_itself(above: float) -> None:
    assert not Condition(signal="a.b", above=above).holds(above)
    assert Condition(signal="a.b", above=above).holds(above + 1e-9)
    assert not Condition(signal="a.b", below=above).holds(above)
    assert not Condition(signal="a.b", above=above).holds(float("nan"))


# What cannot be asked is told before a run


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({}, "needs either signal"),
        ({"signal": "a.b", "prediction": "c", "above": 1.0}, "needs either signal"),
        ({"signal": "a.b"}, "learn.urgent has no bound"),
    ],
)
def test_a_condition_that_says_nothing_is_refused(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ScheduleError, match=sentence):
        Condition(**settings)


class NeverOpened(FakeDevice):
    async def open(self) -> None:
        raise AssertionError("opened before everything was checked")


@pytest.mark.parametrize(
    ("urgent", "sentence"),
    [
        (
            Condition(signal="joint.emergncy", above=0.5),
            "there is no signal 'joint.emergncy': did you mean 'joint.em",
        ),
        (Condition(signal="emergency", above=0.5), "there is no signal 'emergency'"),
        (Condition(prediction="x", above=0.5), "asks for the prediction 'x', and this learner has no demons"),
    ],
)
@pytest.mark.parametrize("when", list(When))
def test_what_is_not_there_is_refused_before_anything_opens(urgent: Condition, sentence: str, when: When) -> None:
    task = Stopping()

    async def main() -> Result:
        schedule = Schedule(REACTIVE, learn=Learn(when=when, urgent=urgent), period=ms)
        return await run({"joint": NeverOpened(stopping_joint().world)}, task, sarsa_agent(task), schedule)

    with pytest.raises(ScheduleError, match=sentence):
        clock.run(main(), "virtual")


def test_an_unknown_prediction_is_refused_with_what_is_near() -> None:
    with pytest.raises(ScheduleError, match="no prediction 'emergency son': did you mean 'emergency soon'"):
        run_deferred(Condition(prediction="emergency son", above=0.5), learner=Foreteller)


def test_a_task_that_says_nothing_is_refused_before_anything_opens() -> None:
    task = HallwayTask()

    async def main() -> Result:
        schedule = Schedule.preset("deferred", period=ms)
        return await run({"hallway": NeverOpened(hallway().world)}, task, sarsa_agent(task), schedule)

    with pytest.raises(ScheduleError, match="the task does not say what is urgent"):
        clock.run(main(), "virtual")


def test_a_task_that_says_nothing_needs_a_condition() -> None:
    task = HallwayTask()

    async def main() -> Result:
        urgent = Condition(signal="hallway.velocity", above=1e9)
        sensors = hallway().spec.sensors
        signal = next(f"hallway.{name}" for name, sensor in sensors.items() if not sensor.shape)
        rules = Learn(when=When.CALM, urgent=Condition(signal=signal, above=urgent.above))
        schedule = Schedule(REACTIVE, learn=rules, period=10 * ms)
        plan = Plan(limits=Limits(episode_time=second))
        return await run({"hallway": hallway()}, task, sarsa_agent(task), schedule, plan)

    assert counted(clock.run(main(), "virtual"))["learned_in_place"] > 10


def with_learn(text: str, *lines: str) -> str:
    return text.replace("[devices.joint]", "\n".join(["[learn]", *lines, "", "[devices.joint]"]))


@pytest.mark.parametrize(
    ("lines", "at", "sentence"),
    [
        (['urgent = { signal = "joint.emergncy", above = 0.5 }'], "urgent =", "did you mean 'joint.emergency'?"),
        (['urgent = { prediction = "x", above = 0.5 }'], "urgent =", "this learner has no demons"),
        (['urgent = { signal = "joint.position" }'], "urgent =", "learn.urgent has no bound"),
        (["urgent = { above = 0.5 }"], "urgent =", "needs either signal"),
        (['urgent = { signal = "a", abov = 1 }'], "abov", "did you mean 'above'?"),
        (['where = "thread"'], "where =", "a thread learns all the time"),
        (['when = "calmly"'], "when =", "Input should be 'always' or 'calm'"),
        (["queue = 0"], "queue =", "greater than or equal to 1"),
    ],
)
def test_a_scenario_tells_what_is_wrong_with_its_file_and_line(
    tmp_path: Path, lines: list[str], at: str, sentence: str
) -> None:
    text = with_learn(STOPPING, *lines)
    (problem,) = problems(tmp_path, text)
    assert problem.startswith(f"scenario.toml:{line_of(text, at)}: ")
    assert sentence in problem


def test_check_refuses_a_task_that_does_not_say_what_is_urgent(capsys: pytest.CaptureFixture[str]) -> None:
    hall = str(SCENARIOS / "hallway.toml")
    assert command_line(["check", hall, "--set", "schedule.preset=deferred"]) == 2
    told = capsys.readouterr().err
    assert "--set schedule.preset=deferred: schedule.preset: learning waits for calm" in told
    assert command_line(["check", hall, "--set", "learn.when=calm"]) == 2
    assert "--set learn.when=calm: learn.when: learning waits for calm" in capsys.readouterr().err


def test_what_was_resolved_is_json_and_toml_that_runs_again(tmp_path: Path) -> None:
    text = with_learn(STOPPING, 'urgent = { signal = "joint.position", above = 2.0 }')
    scenario, out = tmp_path / "one.toml", tmp_path / "out.json"
    scenario.write_text(text)
    again = tmp_path / "again.json"
    quickly = ["--clock", "virtual", "--episodes", "2", "--quiet"]
    assert command_line(["run", str(scenario), "--json", str(out), *quickly]) == 0
    assert command_line(["run", str(out.with_suffix(".scenario.toml")), "--json", str(again), "--quiet"]) == 0

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    first, second_time = (json.loads(path.read_text(), parse_constant=refuse) for path in (out, again))
    assert first["resolved"]["learn"]["urgent"] == {"signal": "joint.position", "prediction": "", "above": 2.0}
    assert first == second_time


# Exit codes


def test_what_is_shed_ends_a_run_with_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "full.toml"
    scenario.write_text(with_learn(STOPPING.replace("deferred", "interruptible"), "queue = 3", 'full = "shed"'))
    options = ["--clock", "virtual", "--episodes", "2", "--json", "-", "--quiet"]
    sampled = ["--set", 'devices.joint.sampling={ rate = "100Hz" }']
    assert command_line(["run", str(scenario), *options, *sampled]) == 1
    learning = json.loads(capsys.readouterr().out)["learning"]
    assert learning["transitions_shed"] > 10
    assert command_line(["run", str(scenario), *options, *sampled, "--set", "learn.full=block"]) == 0
    learning = json.loads(capsys.readouterr().out)["learning"]
    assert learning["transitions_shed"] == 0
    assert learning["learned_under_backpressure"] > 10


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("preset", PRESETS)
def test_learning_that_fails_ends_a_run_with_exit_code_1(preset: str, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--clock", "virtual", "--episodes", "3", "--json", "-", "--quiet"]
    diverging = ["--set", "learner.alpha=1e200", "--set", f"schedule.preset={preset}"]
    assert command_line(["run", str(SCENARIOS / "stopping.toml"), *options, *diverging]) == 1
    told = json.loads(capsys.readouterr().out)
    (fault,) = told["faults"]
    assert fault["source"] == "learning"
    assert "the run went on with the weights that it had" in fault["message"]
    assert told["counters"]["transitions_not_learned"] > 0
    assert all(episode["finished"] for trial in told["trials"] for episode in trial["episodes"])
