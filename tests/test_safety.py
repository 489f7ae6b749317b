"""Safe on every way out: the latch, the watchdog, what stays latched, and the commands."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from guarded import HERE, SCENARIO, Guarded, Line, lines, write
from numpy.random import Generator
from parts import sarsa_agent

from rtagent import Agent, Limits, Plan, Result, RunError, Schedule, clock, latched, living, ms, run, second
from rtagent.__main__ import main
from rtagent.device import Device, LastResort
from rtagent.errors import ClockError, DeviceError, ScenarioError, StoppedError
from rtagent.guard import HangGuard
from rtagent.instruments import Instrument
from rtagent.latch import Latch
from rtagent.protection import Watchdog
from rtagent.scenario import assemble, load
from rtagent.supervision import SupervisedDevice, Supervision
from rtagent.tasks import Stopping
from rtagent.testing import DeviceContract
from rtagent.watchdog.process import WatchdogProcess
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.stopping import stopping_joint

SHORT = Watchdog(timeout=100 * ms, scenario="toy.toml")
PATIENT = Watchdog(timeout=2 * second, scenario="toy.toml")
"""For runs that must not be stopped because others keep this machine busy."""

SHORTLY = ["--set", "watchdog.timeout=2s", "--set", "run.episode_time=100ms"]


@pytest.fixture
def hardware(tmp_path: Path) -> Path:
    return tmp_path / "hardware"


@pytest.fixture
def scenario(tmp_path: Path, hardware: Path) -> Path:
    path = tmp_path / "toy.toml"
    path.write_text(SCENARIO.format(file=hardware))
    return path


def run_guarded(
    joint: Guarded,
    latch: Latch | None = None,
    watchdog: Watchdog = PATIENT,
    *,
    disturb: Callable[[], object] = lambda: None,
    beside: Mapping[str, Device] = MappingProxyType({}),
    trials: int = 1,
    make_agent: Callable[[Generator], Agent] | None = None,
) -> Result:
    """Run the joint for a fifth of a second; `disturb` is called on the loop after the tenth move."""

    class Disturbing(Instrument):
        moves = 0

        def acted(self, *args: object) -> None:
            self.moves += 1
            if self.moves == 10:
                disturb()

    task, schedule = Stopping(), Schedule.preset("reactive", period=5 * ms)
    plan = Plan(trials, limits=Limits(episode_time=200 * ms))
    parts = {"joint": joint, **beside}, task, make_agent or sarsa_agent(task), schedule, plan
    supervision = dict.fromkeys(beside, Supervision(timeout=50 * ms))
    others = {"instruments": [Disturbing()], "supervision": supervision}
    return clock.run(run(*parts, latch=latch, watchdog=watchdog, **others))  # type: ignore[arg-type]  # each its own


MOTION = ("start", "move")


def what(file: Path, *, without: tuple[str, ...] = MOTION) -> list[str]:
    return [line.what for line in lines(file) if line.what not in without]


def moved(file: Path) -> bool:
    return bool(set(MOTION) & set(what(file, without=())))


def watchdogs() -> list[int]:
    """Return the watchdogs of this process."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return [int(child) for child in children if "rtagent.watchdog" in Path(f"/proc/{child}/cmdline").read_text()]


class TestGuarded(DeviceContract):
    @pytest.fixture(autouse=True)
    def _in_its_own_file(self, hardware: Path) -> None:
        self.hardware = hardware

    def make_device(self) -> Guarded:
        return Guarded(file=str(self.hardware))


# The latch


def test_a_latch_is_tripped_once_and_tells_all_who_listen() -> None:
    latch, heard = Latch(), list[int]()
    with latch.heard_by(lambda: heard.append(1)):
        latch.check()
        latch.trip("person", "the cat was in the way")
        latch.trip("limit", "too late")
    with latch.heard_by(lambda: heard.append(2)):
        pass
    assert heard == [1, 2]
    with pytest.raises(StoppedError, match="stopped by person: the cat was in the way"):
        latch.check()


def test_a_latch_that_another_process_trips_is_tripped() -> None:
    latch = Latch()
    tripping = "import mmap, sys; mmap.mmap(int(sys.argv[1]), 1)[0] = 1"
    subprocess.run([sys.executable, "-c", tripping, str(latch.fd)], pass_fds=[latch.fd], check=True)
    with pytest.raises(StoppedError, match="stopped by watchdog"):
        latch.check()


def test_two_threads_that_trip_a_latch_leave_one_reason() -> None:
    for _ in range(20):
        latch, heard = Latch(), list[str]()
        with latch.heard_by(lambda: heard.append(latch.source)):  # noqa: B023  # called within the loop
            threads = [threading.Thread(target=latch.trip, args=(name, name)) for name in ("a", "b")]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        assert heard == [latch.source]
        assert latch.source == latch.reason


# A run and its watchdog


def test_a_normal_run_is_guarded_from_before_its_first_move_until_it_is_safe(hardware: Path) -> None:
    result = run_guarded(Guarded(file=str(hardware)))
    assert what(hardware) == ["guarded", "safe", "closed", "unguarded"]
    assert [line.what for line in lines(hardware)][:3] == ["guarded", "start", "move"]
    assert not result.faults
    assert latched.find(str(hardware)) is None
    assert living.runs() == []
    assert watchdogs() == []


def test_any_thread_can_stop_a_run(hardware: Path) -> None:
    latch = Latch()

    def trip() -> None:
        threading.Thread(target=latch.trip, args=("person", "the cat was in the way")).start()

    with pytest.raises(RunError, match="stopped by person: the cat was in the way") as caught:
        run_guarded(Guarded(file=str(hardware)), latch, disturb=trip)
    assert what(hardware) == ["guarded", "safe", "closed", "unguarded"]
    assert [fault.source for fault in caught.value.result.faults] == ["stop"]
    assert caught.value.result.not_safe == []
    entry = latched.find(str(hardware))
    assert entry is not None
    assert (entry.reason, entry.scenario) == ("stopped by person: the cat was in the way", "toy.toml")


def test_a_run_with_a_tripped_latch_moves_nothing(hardware: Path) -> None:
    latch = Latch()
    latch.trip("person", "not today")
    with pytest.raises(RunError, match="not today"):
        run_guarded(Guarded(file=str(hardware)), latch)
    assert not moved(hardware)


def test_an_episode_does_not_begin_once_the_latch_is_tripped(hardware: Path) -> None:
    latch, joint = Latch(), Guarded(file=str(hardware))

    class Other(FakeDevice):
        async def begin_episode(self, rng: Generator) -> None:
            latch.trip("person", "the cat was in the way")

    with pytest.raises(RunError, match="the cat"):
        run_guarded(joint, latch, beside={"a": Other(stopping_joint().world)})
    assert what(hardware, without=()).count("start") == 1, "that of the joint, which comes first"
    with pytest.raises(StoppedError):
        clock.run(started(joint, latch))


async def started(joint: Guarded, latch: Latch) -> None:
    """Bring a joint to its start as a run does."""
    now = clock.current()
    device = SupervisedDevice("joint", joint, Supervision(), now, HangGuard(now), latch, print, joint.close)
    await device.go_to_start(np.random.default_rng(0))


def test_nothing_moves_before_every_device_has_given_a_sample(hardware: Path) -> None:
    silent = stopping_joint(sampling=Sampling(rate=100.0), faults=Faults(corrupt=1.0))
    with pytest.raises(RunError, match="device 'other' gave no valid sample"):
        run_guarded(Guarded(file=str(hardware)), beside={"other": silent})
    assert not moved(hardware)
    assert latched.find(str(hardware)) is None, "nothing could have moved"


def test_every_agent_is_made_before_hardware_is_opened(hardware: Path) -> None:
    def make_agent(rng: Generator) -> Agent:
        write(str(hardware), "agent")
        return sarsa_agent(Stopping())(rng)

    run_guarded(Guarded(file=str(hardware)), trials=2, make_agent=make_agent)
    assert what(hardware) == [*["agent"] * 2, "guarded", "safe", "closed", "unguarded"]


def test_a_device_that_comes_back_is_guarded_anew(hardware: Path) -> None:
    result = run_guarded(Guarded(file=str(hardware), unplugged=(50 * ms, 60 * ms)))
    assert result.device_counters["joint"]["reopened"] == 1
    said = what(hardware, without=("start", "closed"))
    again = said.index("guarded", 1)
    assert said[again - 1] == "unguarded"
    assert "move" in said[again:]
    assert said[-2:] == ["safe", "unguarded"]


def test_a_limit_stops_a_run_at_once(hardware: Path) -> None:
    latch = Latch()
    with pytest.raises(RunError, match="stopped by limit: the joint is at its limit: move it back by hand"):
        run_guarded(Guarded(file=str(hardware), limit=10), latch)
    assert what(hardware, without=("start",)) == ["guarded", *["move"] * 9, "safe", "closed", "unguarded"]
    assert latch.source == "limit"
    assert latched.find(str(hardware)) is not None


def test_the_watchdog_makes_safe_what_the_driver_cannot(hardware: Path) -> None:
    result = run_guarded(Guarded(file=str(hardware), jammed=True))
    assert what(hardware) == ["guarded", "safe by last resort", "closed", "unguarded"]
    assert result.not_safe == []
    assert "The watchdog made it safe" in result.faults[0].message
    assert latched.find(str(hardware)) is None


def test_what_nothing_can_make_safe_is_named_and_stays_latched(hardware: Path) -> None:
    result = run_guarded(Guarded(file=str(hardware), broken=True))
    assert result.not_safe == ["device 'joint': its torque is still on: cut its power."]
    entry = latched.find(str(hardware))
    assert entry is not None
    assert "cut its power" in entry.reason


def test_a_hung_loop_is_found_by_the_watchdog_and_moves_nothing_afterwards(hardware: Path) -> None:
    moved_late: list[Line] = []

    def hang() -> None:
        time.sleep(0.4)
        moved_late.extend(line for line in lines(hardware) if line.what == "safe by last resort")

    with pytest.raises(RunError, match="stopped by watchdog: the runtime was not heard for 100 ms"):
        run_guarded(Guarded(file=str(hardware)), watchdog=SHORT, disturb=hang)
    assert moved_late, "it was made safe while the loop hung"
    assert what(hardware) == ["guarded", "safe by last resort", "safe", "closed", "unguarded"]
    last_move = max(line.time for line in lines(hardware) if line.what == "move")
    assert last_move < moved_late[0].time
    entry = latched.find(str(hardware))
    assert entry is not None
    assert "not heard for 100 ms" in entry.reason


def test_nothing_moves_without_a_watchdog(hardware: Path) -> None:
    def kill() -> None:
        (watchdog,) = watchdogs()
        os.kill(watchdog, signal.SIGKILL)

    with pytest.raises(RunError, match="stopped by watchdog: its process has died"):
        run_guarded(Guarded(file=str(hardware)), disturb=kill)
    assert what(hardware) == ["guarded", "safe", "closed"]


def test_a_watchdog_that_cannot_reach_the_hardware_lets_nothing_move(hardware: Path) -> None:
    joint = Guarded(file=str(hardware))
    joint.resort = LastResort("guarded:missing", {}, str(hardware))
    with pytest.raises(
        RunError, match="the watchdog cannot reach the hardware, so nothing may move: AttributeError"
    ):
        run_guarded(joint)
    assert not moved(hardware)
    assert latched.find(str(hardware)) is None, "nothing could have moved"


def test_a_watchdog_outlives_what_a_terminal_sends(hardware: Path) -> None:
    def interrupt() -> None:
        (watchdog,) = watchdogs()
        assert os.getsid(watchdog) != os.getsid(0)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(watchdog, number)

    assert not run_guarded(Guarded(file=str(hardware)), disturb=interrupt).faults


def test_a_watchdog_reaches_a_device_where_it_is_now(hardware: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    first, second_place = (Guarded(file=str(file), broken=True).resort for file in (hardware, elsewhere))

    async def move_over() -> dict[str, list[str]]:
        watchdog = WatchdogProcess(second, "", Latch(), lambda said: None)
        try:
            await watchdog.start({"joint": first})
            await watchdog.guard({"joint": second_place})
            with pytest.raises(DeviceError, match="cannot reach"):
                await watchdog.guard({"joint": first.__class__("guarded:missing", {}, "")})
            await watchdog.guard({"joint": second_place})
            return dict(await watchdog.make_safe())
        finally:
            await watchdog.end()

    found = clock.run(move_over())
    assert found == {"joint": ["device 'joint': its torque is still on: cut its power."]}
    assert what(hardware) == ["guarded", "unguarded"]
    assert what(elsewhere) == ["guarded", "unguarded", "guarded", "unguarded"]


def test_hardware_knows_no_virtual_clock(hardware: Path) -> None:
    task = Stopping()
    running = run({"joint": Guarded(file=str(hardware))}, task, sarsa_agent(task), Schedule.preset("reactive"))
    with pytest.raises(ClockError, match="hardware knows no virtual clock"):
        clock.run(running, "virtual")
    assert not hardware.exists()


# What stays latched


def test_hardware_that_is_latched_is_refused_until_it_is_rearmed(
    scenario: Path, hardware: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    latched.latch(str(hardware), "stopped by limit: too hot", "yesterday.toml")
    latched.latch(str(hardware), "something later", "today.toml")
    assert main(["run", str(scenario), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "stopped by limit: too hot (scenario yesterday.toml)" in said
    assert f"rtagent rearm {scenario}" in said
    assert not hardware.exists(), "it was not even opened"
    assert main(["check", str(scenario)]) == 0, "that it is latched is not the scenario's fault"
    assert "a watchdog makes it safe when the event loop stalls for 500 ms" in capsys.readouterr().out
    assert main(["rearm", str(scenario)]) == 0
    assert "too hot" in capsys.readouterr().out
    assert main(["rearm", str(scenario)]) == 0
    assert "was not latched" in capsys.readouterr().out
    assert main(["run", str(scenario), "--quiet", "--episodes", "1", *SHORTLY]) == 0


def test_a_damaged_latch_still_latches(hardware: Path) -> None:
    latched.latch(str(hardware), "stopped", "toy.toml")
    place = latched._place(str(hardware))
    place.write_text("{")
    entry = latched.find(str(hardware))
    assert entry is not None
    assert "cannot be read" in entry.reason
    latched.release(str(hardware))
    assert latched.find(str(hardware)) is None


def test_what_has_no_name_is_never_latched() -> None:
    latched.latch("", "stopped", "toy.toml")
    assert latched.find("") is None


# From another terminal


@contextlib.contextmanager
def living_run(scenario: Path, hardware: Path, **settings: object) -> Iterator[subprocess.Popen[str]]:
    """A run of its own process, from its first moves on."""
    command = [sys.executable, str(HERE / "guarded.py"), "run", str(scenario), "--quiet"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **settings) as process:  # type: ignore[call-overload]  # those of Popen
        try:
            until(lambda: what(hardware, without=()).count("move") > 5)
            yield process
        finally:
            process.kill()


def until(holds: Callable[[], object]) -> None:
    """Wait for something that is bound to happen."""
    deadline = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.005)


def test_a_runtime_that_is_killed_leaves_its_hardware_safe_and_latched(scenario: Path, hardware: Path) -> None:
    with living_run(scenario, hardware) as process:
        process.kill()
        until(lambda: "unguarded" in what(hardware))
    assert what(hardware) == ["guarded", "safe by last resort", "unguarded"]
    entry = latched.find(str(hardware))
    assert entry is not None
    assert "the runtime is gone" in entry.reason
    assert entry.scenario == str(scenario)
    assert living.runs() == [], "the dead are forgotten"


def test_a_runtime_that_was_stopped_finds_itself_latched_when_it_goes_on(scenario: Path, hardware: Path) -> None:
    with living_run(scenario, hardware) as process:
        process.send_signal(signal.SIGSTOP)
        until(lambda: "safe by last resort" in what(hardware))
        moves = len(lines(hardware))
        process.send_signal(signal.SIGCONT)
        _, said = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "stopped by watchdog" in said
    assert [line.what for line in lines(hardware)[moves:]] == ["safe", "closed", "unguarded"], "no move any more"


def test_a_stop_from_another_terminal(scenario: Path, hardware: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with living_run(scenario, hardware) as process:
        assert [each.hardware for each in living.runs()] == [[str(hardware)]]
        scenario.write_text(scenario.read_text().replace('"sarsa"', '"sorcery"'))
        assert main(["stop", str(scenario)]) == 0
        process.communicate(timeout=20)
    assert process.returncode == 1
    said = capsys.readouterr().out
    assert f"The run of process {process.pid} ({scenario}) was stopped." in said
    assert "device 'joint' is safe." in said
    assert what(hardware)[:4] == ["guarded", "safe", "closed", "unguarded"]
    assert what(hardware)[4:] == ["guarded", "safe by last resort"]
    entry = latched.find(str(hardware))
    assert entry is not None
    assert entry.reason == "stopped by rtagent stop"


def test_a_key_stops_a_run_and_the_terminal_is_given_back(scenario: Path, hardware: Path) -> None:
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)

    def take_terminal() -> None:
        os.setsid()
        fcntl.ioctl(theirs, termios.TIOCSCTTY, 0)

    with living_run(scenario, hardware, stdin=theirs, preexec_fn=take_terminal) as process:
        assert termios.tcgetattr(theirs)[3] != before[3]
        os.write(ours, b"x")
        moves = len(lines(hardware))
        until(lambda: len(lines(hardware)) > moves + 5)
        os.write(ours, b" ")
        _, said = process.communicate(timeout=20)
    assert "stopped by keyboard: space" in said
    assert termios.tcgetattr(theirs) == before
    assert what(hardware) == ["guarded", "safe", "closed", "unguarded"]
    for end in (ours, theirs):
        os.close(end)


def test_what_cannot_be_made_safe_is_told_by_stop(
    scenario: Path, hardware: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["stop", str(scenario), "--set", "devices.joint.broken=true"]) == 1
    assert "device 'joint': its torque is still on: cut its power." in capsys.readouterr().out
    assert main(["stop", str(scenario), "--set", "devices.joint.velocity=1"]) == 1
    assert "there is no key 'devices.joint.velocity'" in capsys.readouterr().err
    scenario.write_text("[devices.joint]\nfile = 'x'\n")
    assert main(["stop", str(scenario)]) == 1
    assert "toy.toml:1: there is no driver" in capsys.readouterr().err
    scenario.write_text("[device.joint]\n")
    assert main(["stop", str(scenario)]) == 1
    assert "there are no devices" in capsys.readouterr().err


# Patience


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (
            ["schedule.learn_delay=500ms"],
            r"25 ms \+ 500 ms = 525 ms without one, .* give it more than 667 ms, or learn",
        ),
        (["schedule.learn_delay=500ms", "watchdog.timeout=660ms"], "more than 667 ms"),
        (["learn.slice=80ms"], r"80 ms \(learn.slice\)"),
        (["watchdog.timeout=9ms"], "give at least 10ms"),
        (["devices.joint.tolerates=40", "schedule.learn_delay=60ms"], r"10 ms \+ 60 ms = 70 ms of silence"),
    ],
)
def test_learning_that_would_look_like_a_stall_is_refused(
    scenario: Path, overrides: list[str], sentence: str
) -> None:
    scenario.write_text(scenario.read_text().replace('"guarded"', '"patient"'))
    with pytest.raises(ScenarioError, match=sentence):
        assemble(load(scenario, ["watchdog.timeout=100ms", *overrides]))


@pytest.mark.parametrize(
    "overrides",
    [
        ["schedule.learn_delay=500ms", "watchdog.timeout=670ms"],
        ["schedule.learn_delay=500ms", "learn.slice=1ms"],
        ["schedule.learn_delay=500ms", "learn.where=thread"],
        ["schedule.learn_delay=70ms", f"devices.joint.tolerates={80 * ms + 1}"],
    ],
)
def test_learning_that_leaves_the_loop_its_time_is_taken(scenario: Path, overrides: list[str]) -> None:
    scenario.write_text(scenario.read_text().replace('"guarded"', '"patient"'))
    assert assemble(load(scenario, ["watchdog.timeout=100ms", *overrides])).guarded
