"""Kills and stops runs while a joint of an emulated Bento Arm moves, and sees how soon it is safe."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from _harness import Row

from rtagent import latched

TIMES = 50
TIMEOUT = 100
"""The watchdog's, in ms."""

PATIENCE = 20.0
"""Seconds, after which something that was to happen is taken to have failed."""

SCENARIO = """
[run]
episodes = 100

[schedule]
preset = "reactive"

[watchdog]
timeout = "{timeout}ms"

[devices.bento]
driver = "dynamixel"
port = "{port}"
rate = "100Hz"
stop = "release"

[devices.bento.joints]
shoulder = {{ id = 1, model = "MX-64", mode = "velocity", low = "-120deg", high = "120deg" }}
elbow = {{ id = 2, model = "MX-106", low = "-90deg", high = "90deg" }}
wrist_rotation = {{ id = 3, model = "MX-28", low = "-90deg", high = "90deg" }}
wrist_flexion = {{ id = 4, model = "MX-28", low = "-90deg", high = "90deg" }}
hand = {{ id = 5, model = "MX-28", low = "-90deg", high = "90deg" }}

[devices.timer]
driver = "timer"
after = ["8s", "9s"]

[task]
type = "arm_stopping"
joint = "bento.shoulder"
emergency = "timer.expired"
velocity = "{turn}30deg/s"
end = "{turn}115deg"

[features]
type = "tabular"

[learner]
type = "sarsa"

[policy]
type = "greedy"
"""


MOVES = 0.1
"""rad/s, above which a joint moves."""

STARTS = 5
"""A run may find the emulated bus slow to answer where others keep the machine busy: it is begun so often."""


class TookTooLongError(Exception):
    """Something that was to happen did not."""


class StoppedBeforeError(Exception):
    """The joint was at rest already, or never moved: a run stalls where others keep the machine busy."""


@dataclass
class Bench:
    """An emulated arm, what happens to it, and the scenario of the runs."""

    link: Path
    log: Path
    scenario: Path
    read: int = 0

    @property
    def said(self) -> Path:
        """What the last run, and its watchdog, have said."""
        return self.scenario.with_suffix(".txt")

    def events(self) -> list[dict[str, Any]]:
        """Return what has happened since it was last asked."""
        with self.log.open() as file:
            file.seek(self.read)
            whole = file.read().rpartition("\n")[0]
        self.read += len(whole.encode()) + 1 if whole else 0
        return [json.loads(line) for line in whole.splitlines()]

    def first(
        self, fits: Callable[[dict[str, Any]], bool], unless: Callable[[], bool] = lambda: False
    ) -> dict[str, Any]:
        """Wait for an event of the shoulder that fits, and return it; give up where `unless` holds."""
        ends = time.monotonic() + PATIENCE
        while time.monotonic() < ends and not unless():
            for event in self.events():
                if event.get("joint") == "shoulder" and fits(event):
                    return event
            time.sleep(0.002)
        raise TookTooLongError

    def start(self, turn: str) -> subprocess.Popen[bytes]:
        """Begin a run, and return its process once the joint moves; one that could not begin is begun again."""
        self.scenario.write_text(SCENARIO.format(port=self.link, timeout=TIMEOUT, turn=turn))
        command = [sys.executable, "-m", "rtagent", "run", str(self.scenario), "--quiet"]
        for _ in range(STARTS):
            self.events()  # those of the run before
            with self.said.open("wb") as said:
                run = subprocess.Popen(command, stderr=said, stdin=subprocess.DEVNULL)
            if self._moves(run):
                return run
            run.kill()
            run.wait()
        raise StoppedBeforeError

    def _moves(self, run: subprocess.Popen[bytes]) -> bool:
        """Wait until the joint moves; say whether it does before the run is over."""
        try:
            self.first(lambda event: abs(event["velocity"]) > MOVES, unless=lambda: run.poll() is not None)
        except TookTooLongError:
            return False
        return True


@contextmanager
def bench() -> Iterator[Bench]:
    """Emulate an arm, in a folder that takes what stays latched."""
    homes = ("XDG_STATE_HOME", "XDG_RUNTIME_DIR")
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, dict.fromkeys(homes, folder)):
        made = Bench(Path(folder) / "bento", Path(folder) / "log", Path(folder) / "bento.toml")
        command = [sys.executable, "-m", "rtagent", "emulate", "bento", "--link", str(made.link)]
        command += ["--log", str(made.log)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as emulator:
            try:
                assert emulator.stdout is not None
                emulator.stdout.readline()
                yield made
            finally:
                emulator.terminate()


def safe_after(made: Bench, number: signal.Signals, trial: int) -> tuple[float, int]:
    """Send a signal to a run; return after how long (ms) the torque was off, and how many goals were sent later.

    Raises `StoppedBeforeError` where the joint was at rest by then.
    """
    run = made.start("-" if trial % 2 else "")
    try:
        time.sleep(random.Random(trial).uniform(0.05, 0.3))  # noqa: S311  # nothing secret is drawn
        if run.poll() is not None or any(map(is_off, made.events())):
            raise StoppedBeforeError
        sent = time.monotonic_ns()
        run.send_signal(number)
        off = made.first(is_off)
        if off["time"] < sent or abs(off["velocity"]) < MOVES:
            raise StoppedBeforeError
        goals = _goals_after_going_on(made, run) if number == signal.SIGSTOP else 0
        return (off["time"] - sent) / 1e6, goals
    finally:
        run.kill()
        run.wait()
        _forget_latch(made)


def is_off(event: dict[str, Any]) -> bool:
    """Say whether a servo's torque went off."""
    return event["event"] == "torque_enable" and not event["value"]


def _goals_after_going_on(made: Bench, run: subprocess.Popen[bytes]) -> int:
    """Let a run go on to its end; return how many goals it still sent."""
    made.events()
    run.send_signal(signal.SIGCONT)
    assert run.wait(PATIENCE) == 1, "it found itself stopped"
    return sum(event["event"] in ("goal_position", "goal_velocity") for event in made.events())


def _forget_latch(made: Bench) -> None:
    """Wait until the run, or its watchdog, has latched the arm, and re-arm it."""
    ends = time.monotonic() + PATIENCE
    while latched.find(str(made.link)) is None and time.monotonic() < ends:
        time.sleep(0.005)
    latched.release(str(made.link))


def safety_rows(times: int = TIMES) -> Iterator[Row]:
    """Yield, for both signals, how often the arm was made safe, and the median and longest time until then."""
    with bench() as made:
        for number, reach in ((signal.SIGKILL, 100.0), (signal.SIGSTOP, TIMEOUT + 50.0)):
            found, stalled = attempts(made, number, times)
            took = sorted(milliseconds for milliseconds, _ in found)
            name = f"{number.name} of the runtime while a joint moves"
            yield Row(f"{name}: made safe, of {times}", len(found), "×", float(times), "higher")
            yield Row(f"{name}: torque off, median", took[len(took) // 2] if took else float("nan"), "ms")
            yield Row(f"{name}: torque off, longest", took[-1] if took else float("nan"), "ms", reach)
            yield Row("runs beside these that had stalled before, and were stopped", stalled, "×")
            if number == signal.SIGSTOP:
                yield Row("goals sent after it went on", sum(goals for _, goals in found), "", 0.0)


def attempts(made: Bench, number: signal.Signals, times: int) -> tuple[list[tuple[float, int]], int]:
    """Return what `times` runs came to, without those that were not made safe, and how many others had stalled."""
    found: list[tuple[float, int]] = []
    failed = stalled = 0
    while len(found) + failed < times and stalled < times:
        try:
            found.append(safe_after(made, number, len(found) + failed + stalled))
        except StoppedBeforeError:
            stalled += 1
        except TookTooLongError:
            failed += 1
            sys.stderr.write(f"{number.name}: it was not made safe. {made.said.read_text()}")
    return found, stalled


if __name__ == "__main__":
    from _harness import main

    sys.exit(main(lambda: safety_rows(int(os.environ.get("TIMES", TIMES))), __doc__))
