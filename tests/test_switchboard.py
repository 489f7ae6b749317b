"""The switchboard: its sensors by the rules of its world, its phases, and the task."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import read_in_any_order
from hypothesis import given, settings
from hypothesis import strategies as st

from rtagent import Observation, Sample, Stimulus, ms, second
from rtagent.errors import SpecError
from rtagent.tasks import Switchboard
from rtagent_drivers.switchboard import SwitchboardWorld, Traffic, switchboard

START = 10**15
TRAFFIC = Traffic(
    calm=(2 * second, 3 * second),
    busy=(second, 2 * second),
    calm_gap=(700 * ms, 1400 * ms),
    busy_gap=(150 * ms, 250 * ms),
    patience=120 * ms,
    lead=300 * ms,
    rewired=2,
)
LINES, OUTLETS = 3, 2
TIMES = st.integers(0, 20 * second)
ANSWERS = st.lists(st.tuples(TIMES, st.integers(0, LINES), st.integers(0, OUTLETS - 1)), max_size=30)


def world(seed: int = 0, traffic: Traffic = TRAFFIC) -> SwitchboardWorld:
    made = SwitchboardWorld(LINES, OUTLETS, traffic)
    made.begin(START, np.random.default_rng(seed))
    return made


def calls(seed: int, until: int = 25 * second) -> list[tuple[int, str]]:
    return [(stimulus.time, stimulus.kind) for stimulus in world(seed).stimuli(START - 1, START + until)]


def story(answers: list[tuple[int, int, int]], seed: int, time: int) -> tuple[int, float]:
    """Tell which line rings, and what was earned, from the calls alone and the rules."""
    ringing, earned = 0, 0.0
    for begins, kind in calls(seed):
        line = int(world(seed).values(begins)["line"])
        mine = [
            each for each in answers if begins <= START + each[0] < begins + TRAFFIC.patience and each[1] == line
        ]
        first = min(mine, default=None)
        answered = first is not None and START + first[0] <= time
        if answered and first is not None and kind == f"call for outlet {first[2]}":
            earned += 1 - (START + first[0] - begins) / TRAFFIC.patience
        if begins <= time < begins + TRAFFIC.patience and not answered:
            ringing = line
    return ringing, earned


@given(ANSWERS, TIMES, st.integers(0, 3))
@settings(max_examples=40, deadline=None)
def test_what_rings_and_what_is_earned_follow_the_rules(
    answers: list[tuple[int, int, int]], time: int, seed: int
) -> None:
    answers = sorted({when: (when, line, outlet) for when, line, outlet in answers}.values())
    board = world(seed)
    for when, line, outlet in answers:
        if when <= time:
            board.command(START + when, {"line": line, "outlet": outlet})
    values = board.values(START + time)
    ringing, earned = story(answers, seed, START + time)
    assert values["line"] == ringing
    assert values["reward"] == pytest.approx(earned)
    for name, value in values.items():
        assert board.spec.sensors[name].problem(value) is None


def test_an_answer_in_time_earns_what_is_left_of_the_patience_and_a_second_one_nothing() -> None:
    board = world()
    begins, kind = calls(0)[0]
    line, right = int(board.values(begins)["line"]), int(kind[-1])
    board.command(begins + 30 * ms, {"line": line, "outlet": right})
    board.command(begins + 40 * ms, {"line": line, "outlet": right})
    assert board.values(begins + 30 * ms)["reward"] == pytest.approx(0.75)
    assert board.values(begins + 50 * ms)["reward"] == pytest.approx(0.75)
    assert board.values(begins + 30 * ms)["line"] == 0
    assert board.values(begins + 29 * ms)["line"] == line


def test_calls_are_many_in_busy_phases_which_the_lamp_announces() -> None:
    board, step = world(), 10 * ms
    seen = [board.values(START + time) for time in range(0, 60 * second, step)]
    onsets = [place for place in range(1, len(seen)) if seen[place]["busy"] > seen[place - 1]["busy"]]
    lights = [place for place in range(1, len(seen)) if seen[place]["lamp"] > seen[place - 1]["lamp"]]
    assert len(onsets) > 10
    early = [onset - light for onset, light in zip(onsets, lights, strict=False)]
    assert all(abs(each * step - TRAFFIC.lead) <= step for each in early)
    traffic = {busy: [float(each["traffic"]) for each in seen if each["busy"] == busy] for busy in (False, True)}
    assert np.mean(traffic[True]) > 2 * np.mean(traffic[False])


def test_without_a_lead_the_lamp_is_never_on() -> None:
    board = world(traffic=replace(TRAFFIC, lead=0))
    assert not any(board.values(START + time)["lamp"] for time in range(0, 20 * second, 20 * ms))


def wirings(rewired: int) -> list[dict[int, str]]:
    """Return what each line was wired to in each of twelve busy phases."""
    board = world(traffic=replace(TRAFFIC, rewired=rewired, busy=(5 * second, 6 * second)))
    found: list[dict[int, str]] = []
    was_busy = False
    for stimulus in board.stimuli(START, START + 100 * second):
        values = board.values(stimulus.time)
        if values["busy"] and not was_busy:
            found.append({})
        was_busy = bool(values["busy"])
        if was_busy:
            assert found[-1].setdefault(int(values["line"]), stimulus.kind) == stimulus.kind, "within a phase"
    return found[:12]


def test_the_board_is_wired_anew_at_every_so_many_busy_phases() -> None:
    same = wirings(0)
    assert all(each[line] == same[0][line] for each in same for line in each if line in same[0])
    other = wirings(1)
    assert any(each[line] != other[0][line] for each in other for line in each if line in other[0])


@given(st.lists(TIMES, max_size=12), st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_what_is_read_at_a_time_does_not_depend_on_the_order_of_reading(times: list[int], seed: int) -> None:
    moments = [START + time for time in times]
    for first, again in read_in_any_order(world(seed).values, moments, np.random.default_rng(seed)):
        assert first == again


@given(TIMES, st.integers(0, 9))
@settings(max_examples=60, deadline=None)
def test_nothing_changes_before_the_next_change_and_something_does_then(time: int, seed: int) -> None:
    board, now = world(seed), START + time
    change = board.next_change(now)
    assert change is not None
    assert board.values(change - 1) == board.values(now)
    assert board.values(change) != board.values(now)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"patience": 200 * ms}, "patience"),
        ({"lead": 20 * second}, "lead"),
        ({"calm": (2, 1)}, "calm is"),
        ({"outlets": 1}, "2 outlets"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(settings: dict[str, object], sentence: str) -> None:
    with pytest.raises(SpecError, match=sentence):
        switchboard(**settings)  # type: ignore[arg-type]  # each is wrong in its own way


def seen(values: dict[str, float | int | bool]) -> Observation:
    return Observation(START, {"board": Sample(values, START, START, 0)})


def test_the_task_answers_the_line_that_rang_in_the_newest_observation() -> None:
    task = Switchboard(outlets=OUTLETS)
    task.bind({"board": world().spec})
    task.begin()
    outcome = task.interpret(seen({"line": 2, "lamp": True, "traffic": 3.0, "reward": 1.5}))
    assert (tuple(outcome.state), outcome.reward, outcome.terminated) == ((2.0, 1.0, 3.0), 1.5, False)
    assert task.commands(1) == {"board": {"line": 2, "outlet": 1}}
    assert task.interpret(seen({"line": 0, "lamp": True, "traffic": 3.0, "reward": 2.0})).reward == 0.5
    assert task.answers(1, Stimulus(0, "call for outlet 1"))
    assert not task.answers(0, Stimulus(0, "call for outlet 1"))
    with pytest.raises(SpecError, match="outlets"):
        Switchboard(outlets=OUTLETS + 1).bind({"board": world().spec})
