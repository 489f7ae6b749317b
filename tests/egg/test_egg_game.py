"""The egg as a game: what is drawn and said, what keys do, and a whole game through a pseudo-terminal."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import select
import socket
import sys
import termios
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
from parts import ROOT, SCENARIOS

from rtagent import Observation, RunError, clock
from rtagent.__main__ import main
from rtagent.clock.real import RealClock
from rtagent.experiments.egg.attempts import Attempt, Judge
from rtagent.experiments.egg.conditions import CONTROL, REACTIVE_SARSA, SARSA, Wired, in_conditions
from rtagent.keys import Key
from rtagent.latch import Latch
from rtagent.play import scene
from rtagent.play.game import Game
from rtagent.play.key_reader import KeyReader
from rtagent.play.outcome import table, write
from rtagent.scenario import assemble, load
from rtagent.tasks import ArmStopping
from rtagent.units import degree, ms, second
from rtagent_drivers.egg import egg

LIVE = ("run.clock=virtual", "devices.arm.participant.strategy=live")
WIRED = {CONTROL: Wired(), SARSA: Wired(), REACTIVE_SARSA: Wired()}
WHOLE = Attempt(SARSA, 0.7, 0.775, 8 * degree, broken=False)
BROKEN = Attempt(REACTIVE_SARSA, 0.9, 0.925, -3 * degree, broken=True)


# What is drawn and said


@pytest.mark.parametrize(
    ("gone", "arm", "egg"), [(0.0, 0, "O"), (0.5, 24, "O"), (0.999, 47, "O"), (1.1, 53, "*"), (9.0, 59, "*")]
)
def test_the_arm_is_drawn_on_its_way_and_an_egg_that_it_reaches_is_crushed(gone: float, arm: int, egg: str) -> None:
    """The egg is at 60 / 1.25 = 48 characters."""
    drawn = scene.line(gone)
    assert len(drawn) == 60
    assert (drawn[48], drawn.index("▶")) == (egg, arm)


def test_how_an_attempt_went_is_said_without_its_condition() -> None:
    said = [scene.told(each, 3, 50) for each in (WHOLE, BROKEN, Attempt(SARSA, None, None, -0.1, broken=True))]
    assert said == [
        "attempt 3 of 50: stopped 8.0° before the egg",
        "attempt 3 of 50: crushed: 3.0° too far",
        "attempt 3 of 50: crushed: you did not press",
    ]


def test_conditions_are_revealed_with_what_came_of_them() -> None:
    from rich.console import Console

    out = io.StringIO()
    Console(file=out, width=120).print(table([WHOLE, WHOLE, BROKEN]))
    lines = [line.split() for line in out.getvalue().splitlines()]
    assert lines[2] == ["SARSA", "2", "0", "8.0°", "75", "ms"]
    assert lines[3] == ["reactive", "SARSA", "1", "1", "25", "ms"]


@pytest.mark.slow
def test_a_figure_of_ones_own_is_written(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert "mine.png" in write([WHOLE, BROKEN, WHOLE], tmp_path / "mine")
    assert (tmp_path / "mine.svg").stat().st_size > 1000


# What keys do


class Hand:
    """Presses a key while the joint has so much of its way left or less, and before it moves."""

    def __init__(self, game: Game, task: ArmStopping, left: float, key: str) -> None:
        self._game, self._task, self._left, self._key = game, task, left, Key(key)

    def observed(self, observation: Observation, stimuli: object) -> None:
        seen = self._task.seen(observation.samples)
        if seen.speed == 0.0 or seen.left < self._left:
            self._game.hear(self._key, observation.time)


def played(conditions: Sequence[str], left: float, key: str = "b") -> tuple[Judge, str]:
    """Play a game under the virtual clock, with keys that come when the joint has `left` (rad) to go."""
    run, blinding = in_conditions(assemble(load(SCENARIOS / "egg.toml", LIVE)), conditions, WIRED)
    assert isinstance(run.task, ArmStopping)
    judge, out, latch = Judge(run.task, conditions), io.StringIO(), Latch()
    game = Game(judge, run.devices["arm"].press, "b", latch, out)  # type: ignore[attr-defined]  # it can be pressed

    async def play() -> None:
        import asyncio

        game.introduce()
        game.hear(Key("b"), 0)
        assert game.wait()
        game.play_on(asyncio.get_running_loop())
        await run.run([blinding, judge, game, Hand(game, run.task, left, key)], latch=latch)

    try:
        clock.run(play(), "virtual")
    finally:
        game.close()
    return judge, out.getvalue()


def test_a_key_stops_the_arm_and_only_while_it_moves() -> None:
    """Pressed as seen with at most 30° left: SARSA acts 50 ms, 5°, later, and both need 5° to stop."""
    judge, out = played([CONTROL, SARSA, REACTIVE_SARSA], 30 * degree)
    control, standard, reactive = judge.attempts
    assert not any(each.broken for each in judge.attempts)
    for each, lag in ((control, 0.0), (standard, 0.05), (reactive, 0.0)):
        assert each.acted == pytest.approx((each.pressed or 0.0) + 0.05 + lag, abs=1e-6)
    assert "1 attempts to practise, then 2 more" in out
    assert "attempt 3 of 3: stopped" in out
    assert CONTROL not in out.split("begin.")[1]


def test_esc_ends_the_game() -> None:
    latch = Latch()
    run = SimpleNamespace(conditions=[CONTROL], attempts=[], moving=False)
    game = Game(run, lambda time: None, "b", latch, io.StringIO())  # type: ignore[arg-type]  # as far as it is asked
    game.hear(Key("escape"), 0)
    assert not game.wait()
    assert latch.source == "keyboard"
    with pytest.raises(RunError, match="keyboard"):
        played([CONTROL], 30 * degree, "escape")


def test_where_the_arm_is_now_follows_from_where_it_was_seen_but_not_for_long() -> None:
    """Seen with 0.4 of 1 rad left, at 1 rad/s: 0.6, 0.65 after 50 ms, and never more than 0.7."""
    task = SimpleNamespace(seen=lambda samples: samples, speed=1.0)
    judge = Judge(task, [SARSA])  # type: ignore[arg-type]  # as far as it is asked
    assert (judge.gone(0), judge.moving) == (0.0, False)
    for left, speed in ((1.0, 0.0), (0.4, 1.0)):
        judge.observed(SimpleNamespace(samples=SimpleNamespace(time=7 * second, left=left, speed=speed)), ())  # type: ignore[arg-type]
    gone = [judge.gone(7 * second + after * ms) for after in (0, 50, 100, 5000)]
    assert gone == pytest.approx([0.6, 0.65, 0.7, 0.7])
    assert judge.moving


def test_a_press_at_a_time_that_was_looked_at_already_counts_as_just_after() -> None:
    """So that its stimulus is not lost between two observations."""

    async def pressed() -> list[int]:
        device = egg()
        await device.open()
        seen = (await device.read(-1)).world_time
        device.press(seen - 5)
        return [stimulus.time - seen for stimulus in device.stimuli(seen, seen + second)]

    assert clock.run(pressed()) == [1]


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    ours, theirs = pty.openpty()
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


def test_keys_come_with_their_time_and_the_terminal_is_given_back(terminal: tuple[int, int]) -> None:
    ours, theirs = terminal
    before, heard, enough = termios.tcgetattr(theirs), list[tuple[str, int]](), threading.Event()

    def hear(key: Key, time: int) -> None:
        heard.append((key.name, time))
        if len(heard) == 3:
            enough.set()

    reader = KeyReader(theirs, hear)
    began = RealClock.now()
    os.write(ours, b"b\x1b")
    os.write(ours, b" ")
    assert enough.wait(10)
    reader.close()
    assert [name for name, _ in heard] == ["b", "escape", "space"]
    assert all(began <= time <= RealClock.now() for _, time in heard)
    assert termios.tcgetattr(theirs) == before


# The command


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["run", *arguments]) == 2
    return capsys.readouterr().err


def test_without_a_terminal_nobody_can_play(capsys: pytest.CaptureFixture[str]) -> None:
    assert "keys of a terminal" in refused(capsys, str(SCENARIOS / "egg.toml"), "--human")


@pytest.mark.parametrize(
    ("scenario", "settings", "sentence"),
    [
        ("stopping", [], "for the task arm_stopping with an obstacle"),
        ("bento_stopping", [], "for the task arm_stopping with an obstacle"),
        ("egg", ["run.clock=virtual"], "people know no virtual clock"),
        ("egg", ["checkpoint.file=game.ckpt"], "leave out --checkpoint"),
        ("egg", ['task.signals=["arm.hammer_position"]', "features={type='binned'}"], "know Emergency alone"),
        ("egg", ["task.emergency=nobody.pressed"], "there is no device 'nobody'"),
        (
            "bento_egg",
            ["task.emergency=timer.expired", "devices.timer.driver=timer", "run.fake=process"],
            "'timer' cannot be pressed",
        ),
    ],
)
def test_what_nobody_can_play_is_refused(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    scenario: str,
    settings: Sequence[str],
    sentence: str,
) -> None:
    monkeypatch.setattr("os.isatty", lambda file: True)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: 0))
    given = [each for setting in settings for each in ("--set", setting)]
    said = refused(capsys, str(SCENARIOS / f"{scenario}.toml"), "--human", str(tmp_path / "mine"), *given)
    assert sentence in said


def test_a_figure_that_is_there_is_not_written_over(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("os.isatty", lambda file: True)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: 0))
    (tmp_path / "mine.svg").touch()
    assert "there already" in refused(capsys, str(SCENARIOS / "egg.toml"), "--human", str(tmp_path / "mine"))
    nowhere = str(tmp_path / "no" / "mine")
    assert "folder that exists" in refused(capsys, str(SCENARIOS / "egg.toml"), "--human", nowhere)


class Player:
    """Plays `rtagent run … --human` at the other end of a pseudo-terminal, by what it draws there."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "rtagent", "run", *arguments]
        self._pid, self._end = pty.fork()
        if self._pid == 0:
            os.execv(sys.executable, command)  # noqa: S606  # our own command
        self.seen = ""

    def read(self) -> bool:
        """Read what is drawn; say whether there is more to come."""
        ready, _, _ = select.select([self._end], [], [], 30)
        try:
            self.seen += os.read(self._end, 4096).decode(errors="ignore") if ready else ""
        except OSError:  # it has ended
            return False
        return bool(ready)

    def play(self, place: int, press: Callable[[], object] | None = None) -> int:
        """Begin, press the key, or as `press` does, when the arm is drawn at `place`; return the exit code."""
        begun = ready = False
        while self.read():
            begins, arm = "to begin" in self.seen and not begun, self._arm()
            ready = ready or arm < place // 2
            if begins or (ready and arm >= place and press is None):
                os.write(self._end, b"b")
                begun, ready = True, False
            elif ready and arm >= place and press is not None:
                press()
                ready = False
        _, status = os.waitpid(self._pid, 0)
        os.close(self._end)
        return os.waitstatus_to_exitcode(status)

    def _arm(self) -> int:
        """Return where the arm was drawn last."""
        drawn = re.findall(r"\r\x1b\[K([▶·O*]+)(?=\r)", self.seen[-600:])
        return drawn[-1].index("▶") if drawn else 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "further", "place"),
    [("egg", ["--set", 'devices.arm.start=["300ms","300ms"]'], 20), ("bento_egg", ["--fake=process"], 20)],
)
def test_a_whole_game_through_a_terminal(scenario: str, further: list[str], place: int, tmp_path: Path) -> None:
    """Three attempts in real time; how much later SARSA acts is compared with how long learning takes, at most."""
    results = tmp_path / "played.json"
    own = ["--human", str(tmp_path / "mine"), "--json", str(results), "--set", "telemetry.enabled=false"]
    player = Player(str(ROOT / "scenarios" / f"{scenario}.toml"), "--episodes", "3", *own, *further)
    assert player.play(place) == 0, player.seen
    attempts = json.loads(results.read_text())["attempts"]
    assert sorted(each["condition"] for each in attempts) == [CONTROL, REACTIVE_SARSA, SARSA]
    gaps = {each["condition"]: each["acted"] - each["pressed"] for each in attempts}
    assert all(gap >= 0 for gap in gaps.values())
    assert gaps[SARSA] >= 0.05 > 0, "it learns first"
    assert "reactive SARSA" in player.seen.split("Your figure")[0]


@pytest.mark.slow
def test_the_button_of_the_page_stops_the_arm(tmp_path: Path) -> None:
    """It begins with a key; what the page sends when its button is clicked is sent here."""
    from rtagent.telemetry.connection import Access, open_client
    from rtagent.telemetry.control import command
    from rtagent.telemetry.keys import place_of

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        there = Access(endpoint=f"tcp/127.0.0.1:{found.getsockname()[1]}")
    results = tmp_path / "played.json"
    own = ["--human", str(tmp_path / "mine"), "--json", str(results), "--episodes", "3"]
    settings = ["--set", f"telemetry.endpoint={there.endpoint}", "--set", "task.velocity=40deg/s"]
    player = Player(str(SCENARIOS / "egg.toml"), *own, *settings)

    def press() -> None:
        session = open_client(there)
        keys = [str(each.ok.key_expr) for each in session.liveliness().get("rtagent/**") if each.ok is not None]
        assert command(session, place_of(keys[0]), "press", "arm") == "done"
        session.close()

    assert player.play(8, press) == 0, player.seen
    attempts = json.loads(results.read_text())["attempts"]
    assert len(attempts) == 3
    assert any(each["acted"] is not None and not each["broken"] for each in attempts)
