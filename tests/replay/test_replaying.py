"""What was recorded of a run, through its agent again: the same choices, the same weights."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from keeping import learned, run_scenario
from parts import SCENARIOS

from rtagent.__main__ import main
from rtagent.clock import ClockName
from rtagent.errors import ReplayError
from rtagent.replay.events import Began, Chose, Event, Knew, Learned, Observed
from rtagent.replay.journal import Journal
from rtagent.replay.replayer import Replayed, Replayer, manner
from rtagent.result import Result
from rtagent.scenario import assemble, load

PRESETS = ["standard", "reactive", "deferred", "interruptible", "background", "learned"]
HORDE = ["horde.features.prototypes=60", "devices.arm.joints=2", "run.episodes=2"]
EXPLORES = ["policy.type=epsilon_greedy", "policy.epsilon=0.3"]
QUICK = ['devices.joint.onset=["30ms","50ms"]', "learn.queue=20"]


def recorded(name: str, overrides: Sequence[str], clock_name: ClockName) -> tuple[Result, list[Event]]:
    journal = Journal()
    return run_scenario(name, overrides, None, clock_name, instruments=[journal]), journal.events


def replayed(name: str, overrides: Sequence[str], events: Sequence[Event], changes: Sequence[str] = ()) -> Replayed:
    assembly = assemble(load(SCENARIOS / f"{name}.toml", [*overrides, *changes]))
    plan, how = assembly.plan, manner(assembly.schedule, changed=bool(changes))
    replayer = Replayer(assembly.task, assembly.make_agent, assembly.schedule, plan.limits, plan.seed, how)
    return replayer.replay(events)


def check_same(result: Result, outcome: Replayed) -> None:
    assert outcome.same
    assert outcome.choices or not result.schedule.acts
    assert outcome.deltas == sum(episode.steps for episode in result.episodes) > 0
    assert outcome.weights == len(result.agents)
    assert [learned(agent) for agent in outcome.agents] == [learned(agent) for agent in result.agents]
    assert outcome.returns == [episode.total_reward for episode in result.episodes]


@pytest.mark.parametrize("preset", PRESETS)
def test_a_run_in_virtual_time_is_replayed_exactly(preset: str) -> None:
    overrides = [
        "run.episodes=3",
        "run.trials=2",
        "schedule.learn_delay=5ms",
        *EXPLORES,
        f"schedule.preset={preset}",
    ]
    result, events = recorded("stopping", overrides, "virtual")
    check_same(result, replayed("stopping", overrides, events))


@pytest.mark.parametrize("preset", PRESETS)
def test_a_run_in_real_time_is_replayed_exactly(preset: str) -> None:
    overrides = [*HORDE, *QUICK, *EXPLORES, f"schedule.preset={preset}"]
    result, events = recorded("stopping_horde", overrides, "real")
    outcome = replayed("stopping_horde", overrides, events)
    check_same(result, outcome)
    assert result.agents[0].rng.random() == outcome.agents[0].rng.random() or preset == "background"


@pytest.mark.parametrize(
    ("name", "more"),
    [("hallway_synchronous", []), ("predict", ["features.prototypes=60", "devices.arm.arm.duration=8s"])],
)
def test_so_are_other_tasks(name: str, more: list[str]) -> None:
    overrides = ["run.episode_steps=80", *more]
    result, events = recorded(name, overrides, "virtual")
    check_same(result, replayed(name, overrides, events))


def half_done(events: Sequence[Event]) -> list[int]:
    """Return the places of the choices that were made when an update was half done."""
    return [place for place, event in enumerate(events) if isinstance(event, Chose) and event.pieces]


@pytest.mark.slow
def test_choices_in_the_middle_of_updates_are_replayed_with_what_control_had_learned_by_then() -> None:
    overrides = [*HORDE, "horde.demons.0.bins=2000", "run.episodes=4", *EXPLORES]
    result, events = recorded("stopping_horde", overrides, "real")
    assert half_done(events), "none was made in the middle of an update"
    check_same(result, replayed("stopping_horde", overrides, events))


def test_another_order_of_learning_and_choosing_would_have_chosen_otherwise() -> None:
    overrides = ["run.episodes=4", "schedule.preset=interruptible", "schedule.learn_delay=10ms", *EXPLORES]
    _, events = recorded("stopping", overrides, "virtual")
    late = [event._replace(learned=0, pieces=0) if isinstance(event, Chose) else event for event in events]
    outcome = replayed("stopping", overrides, late)
    assert outcome.other_choices > 0, "the recorded progress of learning is not what decides"
    assert outcome.differs is not None


@pytest.mark.parametrize("kind", [Chose, Learned, Knew])
def test_whatever_is_not_as_it_was_recorded_is_counted(kind: Any) -> None:
    overrides = ["run.episodes=2"]
    _, events = recorded("stopping", overrides, "virtual")
    place = max(place for place, event in enumerate(events) if isinstance(event, kind))
    changes: dict[Any, Any] = {
        Chose: {"action": 1 - getattr(events[place], "action", 0)},
        Learned: {"delta": 0.5},
        Knew: {"digest": "0"},
    }
    events[place] = events[place]._replace(**changes[kind])
    outcome = replayed("stopping", overrides, events)
    assert (outcome.other_choices, outcome.other_deltas, outcome.other_weights) == tuple(
        int(kind is each) for each in (Chose, Learned, Knew)
    )
    assert not outcome.same


@pytest.mark.parametrize("change", ["learner.alpha=0.7", "learner.type=q_learning", "schedule.preset=standard"])
def test_a_changed_scenario_learns_from_what_was_done(change: str) -> None:
    overrides = ["run.episodes=4", *EXPLORES]
    result, events = recorded("hallway_synchronous", overrides, "virtual")
    outcome = replayed("hallway_synchronous", overrides, events, [change])
    assert outcome.transitions == sum(episode.steps for episode in result.episodes)
    same = learned(outcome.agents[0]) == learned(result.agents[0])
    assert same == (change == "schedule.preset=standard"), "in a synchronous world both inline presets learn alike"


def test_a_recording_that_does_not_begin_with_the_run_is_refused() -> None:
    _, events = recorded("stopping", ["run.episodes=2"], "virtual")
    second = next(place for place, event in enumerate(events) if event[:2] == (0, 1) and isinstance(event, Began))
    for rest, said in ((events[second:], "begins with episode 2 of trial 1"), (events[1:], "middle of an episode")):
        with pytest.raises(ReplayError, match=said):
            replayed("stopping", ["run.episodes=2"], rest)


def test_a_recording_of_another_task_is_refused_with_what_is_missing() -> None:
    _, events = recorded("stopping", ["run.episodes=1"], "virtual")
    with pytest.raises(ReplayError, match="does not fit the agent after 0 observations: 'hallway'"):
        replayed("hallway", [], events)


def test_observations_that_are_missing_are_found() -> None:
    _, events = recorded("stopping", ["run.episodes=2"], "virtual")
    place = [place for place, event in enumerate(events) if isinstance(event, Observed)][5]
    with pytest.raises(ReplayError, match="choose needs an observation newer"):
        replayed("stopping", ["run.episodes=2"], events[:place] + events[place + 1 :])


# From files


def command(*words: str) -> int:
    return main(list(words))


def record(path: Path, name: str, *more: str) -> None:
    settings = [f"--set={each}" for each in more]
    scenario = str(SCENARIOS / f"{name}.toml")
    assert command("run", scenario, "--quiet", "--record", str(path), "--clock", "virtual", *settings) == 0


def test_the_command_replays_what_run_has_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    record(
        path,
        "stopping",
        "run.episodes=3",
        "run.trials=2",
        "devices.joint.events={far={signal='position',above=1.0}}",
    )
    assert command("replay", str(path)) == 0
    told = capsys.readouterr().out
    assert "are the recorded ones" in told
    assert "and so are the final weights of 2 trials" in told
    assert command("replay", str(path), "--json", "--set", "learner.alpha=0.9") == 0
    data = json.loads(capsys.readouterr().out)
    assert data["changed"]
    assert data["choices"] > 50
    assert data["errors_compared"] == 0


def test_a_recording_that_is_not_whole_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    record(path, "stopping", "run.episodes=1")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    for place, said in (
        (path, "rtagent recover"),
        (tmp_path / "none.mcap", "none.mcap cannot be read"),
    ):
        assert command("replay", str(place)) == 2
        assert said in capsys.readouterr().err


def test_a_setting_that_does_not_fit_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    record(path, "stopping", "run.episodes=1")
    assert command("replay", str(path), "--set", "learner.alhpa=1") == 2
    assert "did you mean 'alpha'" in capsys.readouterr().err
