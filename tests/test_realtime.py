"""Real-time manners: each asked for and given back, or refused with a sentence and its cure."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from parts import ROOT, SCENARIOS

from rtagent import clock, ms, us
from rtagent.__main__ import main
from rtagent.clock import RealClock
from rtagent.realtime import Manners, Realtime, busy, machine, manners, timeslice
from rtagent.realtime.collector import AT_THE_LATEST, Collector
from rtagent.scenario import assemble, load
from rtagent.scenario.model import RealtimeTable

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="what is asked for is Linux's")

PREDICT = str(SCENARIOS / "predict.toml")
FIFO = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK if sys.platform == "linux" else 0


@pytest.fixture(autouse=True)
def left_as_it_was() -> Iterator[None]:
    """Fail where a test leaves anything behind."""
    before = settings()
    yield
    assert settings() == before


def settings() -> dict[str, object]:
    return {
        "scheduler": os.sched_getscheduler(0),
        "priority": os.sched_getparam(0).sched_priority,
        "affinity": os.sched_getaffinity(0),
        "thresholds": gc.get_threshold(),
        "enabled": gc.isenabled(),
        "frozen": gc.get_freeze_count(),
        "switch": sys.getswitchinterval(),
        "locked": locked_memory(),
    }


def locked_memory() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck:"))


@pytest.fixture(autouse=True)
def without_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take a machine that has no time slices of single threads: those that have are in test_timeslice.py."""
    monkeypatch.setattr(timeslice, "time_slice", lambda: 0)


class Scheduler:
    """The scheduling calls of a machine that grants what it is told to, kept in memory."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, error: OSError | None = None) -> None:
        self.policy, self.priority, self.error = os.SCHED_OTHER, 0, error
        self.calls: list[tuple[int, int]] = []
        monkeypatch.setattr(os, "sched_getscheduler", lambda pid: self.policy)
        monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(self.priority))
        monkeypatch.setattr(os, "sched_setscheduler", self.set)

    def set(self, pid: int, policy: int, parameters: os.sched_param) -> None:
        assert pid == 0
        self.calls.append((policy, parameters.sched_priority))
        if self.error is not None:
            raise self.error
        self.policy, self.priority = policy, parameters.sched_priority


@pytest.fixture
def scheduler(monkeypatch: pytest.MonkeyPatch) -> Scheduler:
    return Scheduler(monkeypatch)


def fifo_is_allowed() -> bool:
    allowed = []

    def attempt() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        except PermissionError:
            allowed.append(False)
        else:
            allowed.append(True)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return allowed[0]


# Priority


def test_by_default_nothing_is_asked_for(scheduler: Scheduler) -> None:
    before = gc.get_threshold(), sys.getswitchinterval(), os.sched_getaffinity(0)
    with manners(Realtime()) as granted:
        assert (gc.get_threshold(), sys.getswitchinterval(), os.sched_getaffinity(0)) == before
        assert granted.as_dict() == {"granted": [], "refused": []}
    assert scheduler.calls == []


def test_the_priority_of_this_machine_is_granted_and_given_back_or_refused() -> None:
    with manners(Realtime(priority=7)) as granted:
        if fifo_is_allowed():
            assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == (FIFO, 7)
            assert granted.granted == ["scheduling priority 7"]
        else:
            assert os.sched_getscheduler(0) != FIFO
            assert "the scheduling priority 7 was refused" in granted.refused[0]


def test_a_priority_is_asked_for_and_given_back(scheduler: Scheduler) -> None:
    with manners(Realtime(priority=50)) as granted:
        assert (scheduler.policy, scheduler.priority) == (FIFO, 50)
        assert granted.as_dict() == {"granted": ["scheduling priority 50"], "refused": []}
    assert (scheduler.policy, scheduler.priority) == (os.SCHED_OTHER, 0)


def test_a_priority_is_given_back_after_an_error(scheduler: Scheduler) -> None:
    with pytest.raises(ZeroDivisionError), manners(Realtime(priority=50)):
        raise ZeroDivisionError
    assert scheduler.policy == os.SCHED_OTHER


def test_threads_of_a_run_do_not_inherit_its_priority() -> None:
    policies: list[int] = []
    with manners(Realtime(priority=7)):
        thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert policies == [os.SCHED_OTHER]


def test_who_may_not_take_back_that_children_are_ordinary_gets_ordinary_scheduling_back(
    scheduler: Scheduler,
) -> None:
    with manners(Realtime(priority=50)):
        keep = scheduler.set

        def only_with_the_flag(pid: int, policy: int, parameters: os.sched_param) -> None:
            if not policy & os.SCHED_RESET_ON_FORK:
                raise PermissionError
            keep(pid, policy, parameters)

        os.sched_setscheduler = only_with_the_flag
    assert scheduler.policy == os.SCHED_OTHER | os.SCHED_RESET_ON_FORK


@pytest.mark.parametrize(
    ("container", "cure"),
    [(False, "sudo setcap cap_sys_nice+ep "), (False, " - rtprio 95"), (True, "`--cap-add SYS_NICE`")],
)
def test_a_refused_priority_is_told_with_its_cure_and_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, container: bool, cure: str
) -> None:
    Scheduler(monkeypatch, PermissionError())
    monkeypatch.setattr(machine, "CONTAINER_MARKS", (tmp_path if container else tmp_path / "none",))
    with manners(Realtime(priority=50, switch_interval=60 * us)) as granted:
        assert granted.granted == ["switch interval 60 µs"]
        assert granted.run(asyncio.sleep(0, "done")) == "done"
    (sentence,) = granted.refused
    assert sentence.startswith("the scheduling priority 50 was refused: ")
    assert cure in sentence


def test_a_user_without_a_name_gets_a_cure_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def nameless() -> str:
        raise KeyError

    monkeypatch.setattr(machine, "CONTAINER_MARKS", ())
    monkeypatch.setattr("getpass.getuser", nameless)
    assert "`* - rtprio 95`" in machine.permission("sys_nice", "rtprio 95")


def test_a_system_without_such_scheduling_is_told_of(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.delattr(os, "sched_setscheduler")
        patch.delattr(os, "sched_setaffinity")
        with manners(Realtime(priority=50, processors=(0,))) as granted:
            assert granted.granted == []
    assert [sentence.split(": ")[0] for sentence in granted.refused] == [
        "binding to processors was refused",
        "the scheduling priority 50 was refused",
    ]


# A loop that is always busy


def test_a_loop_that_never_sleeps_gets_no_priority(scheduler: Scheduler) -> None:
    with manners(Realtime(priority=50), busy=True) as granted:
        assert scheduler.calls == []
    (sentence,) = granted.refused
    assert "never sleeps" in sentence
    assert "give schedule.period a value" in sentence


def computing(monkeypatch: pytest.MonkeyPatch, shares: Sequence[float]) -> None:
    """Let it look as if this thread computed for these shares of the time, look by look, and idled then."""
    monkeypatch.setattr(busy, "INTERVAL", 10 * ms)
    calls, computed, last = 0, 0.0, 0

    def scripted() -> int:
        nonlocal calls, computed, last
        calls, (look, ends) = calls + 1, divmod(calls, 2)
        if ends and look < len(shares):
            computed += shares[look] * (RealClock.now() - last)
        last = RealClock.now()
        return round(computed)

    monkeypatch.setattr(RealClock, "computed", staticmethod(scripted))


@pytest.mark.parametrize(
    ("shares", "kept"),
    [([1, 1], False), ([0, 0, 0, 0.95, 0.95], False), ([1, 0.8, 1, 0.8], True), ([0.8] * 4, True), ([], True)],
)
def test_a_loop_that_turns_out_to_be_always_busy_loses_its_priority(
    scheduler: Scheduler, monkeypatch: pytest.MonkeyPatch, shares: list[float], kept: bool
) -> None:
    computing(monkeypatch, shares)
    with manners(Realtime(priority=50)) as granted:
        granted.run(asyncio.sleep(0.15))
        assert (scheduler.policy == FIFO) == kept
    assert len(granted.refused) == (not kept)
    if not kept:
        assert "was given up during the run" in granted.refused[0]
        assert "give schedule.period a value" in granted.refused[0]


@pytest.mark.slow
def test_a_loop_of_real_priority_that_computes_all_the_time_loses_it() -> None:
    if not fifo_is_allowed():
        pytest.skip("this machine allows no SCHED_FIFO; what its refusal does is tested above")

    async def compute() -> None:
        until = RealClock.now() + 20 * busy.INTERVAL
        while RealClock.now() < until and os.sched_getscheduler(0) == FIFO:
            await clock.current().compute(3 * ms)
            await asyncio.sleep(0)

    with manners(Realtime(priority=7)) as granted:
        granted.run(compute())
        assert os.sched_getscheduler(0) != FIFO
    assert "given up" in granted.refused[0]


def test_a_busy_loop_is_found_before_the_kernel_stops_it() -> None:
    runtime = 950 * ms  # of each second, the kernel's default
    assert runtime > busy.INTERVAL * busy.LOOKS


@pytest.mark.parametrize(
    ("setting", "never_sleeps"),
    [("schedule.period=10ms", False), ("schedule.learn_delay=0", True), ("schedule.learn_delay=50ms", True)],
)
def test_a_scenario_knows_whether_its_loop_sleeps(setting: str, never_sleeps: bool) -> None:
    scenario = load(SCENARIOS / "stopping.toml", [setting])
    assert assemble(scenario).never_sleeps == never_sleeps


@pytest.mark.parametrize(("observe", "never_sleeps"), [("fresh", False), ("latest", True)])
def test_a_loop_sleeps_that_waits_for_the_samples_of_a_device(observe: str, never_sleeps: bool) -> None:
    overrides = ['devices.joint.sampling={ rate = "100Hz" }', f"schedule.observe={observe}"]
    assert assemble(load(SCENARIOS / "stopping.toml", overrides)).never_sleeps == never_sleeps


# Processors


def test_the_loop_and_its_threads_are_bound_to_processors() -> None:
    there = sorted(machine.available_processors())
    with manners(Realtime(processors=(there[-1],))) as granted:
        assert os.sched_getaffinity(0) == {there[-1]}
        assert granted.granted == [f"processor {there[-1]}"]
        assert machine.available_processors() == set(there)


def test_a_processor_that_is_not_there_is_refused_and_those_that_are_named() -> None:
    there = sorted(machine.available_processors())
    before = os.sched_getaffinity(0)
    with manners(Realtime(processors=(there[0], 4097), learner_processors=(4098, 4099))) as granted:
        assert os.sched_getaffinity(0) == before
        granted.place_learner()
        assert os.sched_getaffinity(0) == before
    named = f"name some of {', '.join(map(str, there))}."
    assert granted.refused == [
        f"processor 4097 is not there for this program: {named}",
        f"processor 4098, 4099 is not there for this program: {named}",
    ]


def test_a_thread_that_learns_may_be_put_elsewhere() -> None:
    there = sorted(machine.available_processors())
    placed: list[set[int]] = []

    def learn(granted: Manners) -> None:
        granted.place_learner()
        placed.append(os.sched_getaffinity(0))

    for learner in ((), (there[-1],)):
        with manners(Realtime(processors=(there[0],), learner_processors=learner)) as granted:
            thread = threading.Thread(target=learn, args=(granted,))
            thread.start()
            thread.join()
            assert os.sched_getaffinity(0) == {there[0]}
    assert placed == [{there[0]}, {there[-1]}]


def test_processors_that_are_closed_to_this_program_are_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    bound = {0}
    with monkeypatch.context() as patch:
        patch.setattr(os, "sysconf", lambda name: 8)
        patch.setattr(os, "sched_getaffinity", lambda pid: set(bound))

        def bind(pid: int, wanted: Any) -> None:
            allowed = set(wanted) & {0, 1, 2}  # as a cpuset does
            bound.clear()
            bound.update(allowed)

        patch.setattr(os, "sched_setaffinity", bind)
        assert machine.available_processors() == {0, 1, 2}
        assert bound == {0}
        with pytest.raises(machine.RefusedError, match=r"processor 5 is not there .* name some of 0, 1, 2"):
            machine.refuse_absent((1, 5))


# Garbage


class Cycle:
    def __init__(self) -> None:
        self.own = self


def dead_cycle() -> weakref.ref[Cycle]:
    return weakref.ref(Cycle())


def garbage(objects: int) -> list[object]:
    """Return so many new objects that the collector counts."""
    return [[] for _ in range(objects)]


def test_garbage_is_collected_in_calm_moments_only() -> None:
    with manners(Realtime(gc="calm")) as granted:
        young = dead_cycle()
        kept = garbage(50 * gc.get_threshold()[1] + 2000)
        assert young() is not None, "nothing was collected while objects were made"
        granted.calm()
        assert young() is None
        assert granted.granted == ["garbage collected in calm moments"]
    del kept


def test_what_was_there_before_the_run_is_not_looked_through() -> None:
    before = [[] for _ in range(10)]
    with manners(Realtime(gc="calm")):
        assert gc.get_freeze_count() > len(before)
        assert gc.get_objects(generation=2) == []


def test_garbage_from_before_the_run_is_collected_before_it_is_frozen() -> None:
    gc.disable()
    old = dead_cycle()
    with manners(Realtime(gc="calm")):
        assert old() is None
    gc.enable()


@pytest.fixture
def collector() -> Iterator[Collector]:
    made = Collector()
    yield made
    made.close()


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, int, int], None]:
    """Let the collector see other counts of objects and collections than there are."""
    return lambda *counted: monkeypatch.setattr(gc, "get_count", lambda: counted)


@pytest.mark.parametrize(
    ("counted", "generation"),
    [((0, 99, 99), None), ((699, 99, 99), None), ((700, 9, 99), 0), ((700, 10, 9), 1), ((5000, 10, 10), 1)],
)
def test_no_more_is_collected_than_is_due(
    collector: Collector,
    counts: Callable[[int, int, int], None],
    counted: tuple[int, int, int],
    generation: int | None,
) -> None:
    collector._before = (700, 10, 10)
    collector._full_again = RealClock.now() + 10**12
    counts(*counted)
    before = list(collector.collections)
    collector.calm()
    done = [after - earlier for after, earlier in zip(collector.collections, before, strict=True)]
    assert done == [int(number == generation) for number in range(3)]


def test_a_full_collection_comes_rarely(
    collector: Collector, counts: Callable[[int, int, int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = collector._full_again
    monkeypatch.setattr(RealClock, "now", staticmethod(lambda: now))
    collector._before = (700, 10, 10)
    counts(700, 10, 10)

    def collect_for_a_millisecond(generation: int) -> None:
        nonlocal now
        now += ms

    monkeypatch.setattr(gc, "collect", collect_for_a_millisecond)
    full = []
    for _ in range(2000):
        before = collector.collections[2]
        collector.calm()
        full.append(collector.collections[2] - before)
    assert full[0] == 1
    assert sum(full) == 2
    assert full[1001] == 1


def test_a_run_that_is_never_calm_does_not_fill_the_memory() -> None:
    assert gc.isenabled()
    with manners(Realtime(gc="calm")):
        old = dead_cycle()
        kept = garbage(AT_THE_LATEST + 10)
        assert old() is None
    del kept


# The interpreter, memory


def test_the_switch_interval_is_set() -> None:
    with manners(Realtime(switch_interval=50 * us)) as granted:
        assert sys.getswitchinterval() == pytest.approx(50e-6)
        assert granted.granted == ["switch interval 50 µs"]


def test_memory_is_locked_or_refused() -> None:
    with manners(Realtime(lock_memory=True)) as granted:
        if machine.may_lock_memory():
            assert granted.granted == ["memory locked"]
            assert locked_memory() > 0
        else:
            assert "locking memory was refused" in granted.refused[0]


@pytest.mark.parametrize("limit", [8 << 20, resource.RLIM_INFINITY])
def test_memory_is_not_locked_under_a_limit_nor_where_the_kernel_refuses(
    monkeypatch: pytest.MonkeyPatch, limit: int
) -> None:
    class Library:
        def mlockall(self, flags: int) -> int:
            assert limit == resource.RLIM_INFINITY, "under a limit the kernel is not even asked"
            return -1

    with monkeypatch.context() as patch:
        patch.setattr(machine, "CONTAINER_MARKS", ())
        patch.setattr(machine, "capabilities", lambda: 0)
        patch.setattr(resource, "getrlimit", lambda which: (limit, limit))
        patch.setattr(ctypes, "CDLL", lambda *args, **kwargs: Library())
        with manners(Realtime(lock_memory=True)) as granted:
            assert granted.granted == []
    assert "locking memory was refused: allow it with `sudo setcap cap_ipc_lock+ep" in granted.refused[0]
    assert "- memlock unlimited`" in granted.refused[0]


# uvloop


def test_a_run_is_on_uvloop() -> None:
    async def loop_module() -> str:
        return type(asyncio.get_running_loop()).__mro__[1].__module__

    with manners(Realtime(uvloop=True)) as granted:
        assert granted.run(loop_module()).startswith("uvloop")
        assert granted.granted == ["uvloop"]


def test_without_uvloop_a_run_is_on_the_usual_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "rtagent.clock.uv", raising=False)
    monkeypatch.setitem(sys.modules, "uvloop", None)
    with manners(Realtime(uvloop=True)) as granted:
        assert granted.refused == ["uvloop is not installed: `pip install uvloop`."]
        assert granted.run(asyncio.sleep(0, 7)) == 7


def test_uvloop_is_refused_where_its_timers_would_be_coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> None:
        raise OSError

    monkeypatch.setattr("rtagent.clock.uv.Timerfd", none)
    with manners(Realtime(uvloop=True)) as granted:
        assert "uvloop was refused: this system has no timerfd" in granted.refused[0]


# Runs


def test_under_the_virtual_clock_nothing_applies_and_that_is_said_once(scheduler: Scheduler) -> None:
    everything = Realtime(50, (0,), (0,), "calm", 50 * us, True, True)
    with manners(everything, "virtual") as granted:
        assert scheduler.calls == []
        assert gc.get_freeze_count() == 0

        async def is_virtual() -> bool:
            return clock.current().virtual

        assert granted.run(is_virtual())
    assert granted.granted == []
    assert len(granted.refused) == 1
    with manners(Realtime(), "virtual") as granted:
        assert granted.refused == []


def test_a_run_with_all_manners_tells_them_on_the_terminal_and_in_the_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    wanted = [
        "priority=30", "processors=[0]", "learner_processors=[4097]", 'gc="calm"',
        "switch_interval=50us", "uvloop=true", "lock_memory=true",
    ]  # fmt: skip
    settings = [part for setting in wanted for part in ("--set", f"realtime.{setting}")]
    run = ["--clock", "real", "--set", "run.episode_time=300ms", "--set", "devices.arm.arm.duration=2s"]
    assert main(["run", PREDICT, *run, *settings, "--json", str(out)]) == 0
    printed, err = capsys.readouterr()
    told = json.loads(out.read_text())["realtime"]
    assert len(told["granted"]) + len(told["refused"]) == len(wanted)
    assert {"processor 0", "switch interval 50 µs", "uvloop"} <= set(told["granted"])
    assert f"real-time manners: {', '.join(told['granted'])}\n" in printed
    notes = [line for line in err.splitlines() if line.startswith("note: ")]
    assert notes == [f"note: {sentence}" for sentence in told["refused"]]
    assert any("processor 4097 is not there" in sentence for sentence in told["refused"])
    copy = load(out.with_suffix(".scenario.toml")).model.realtime
    assert (copy.priority, copy.processors, copy.gc, copy.switch_interval) == (30, (0,), "calm", 50 * us)


def test_a_busy_scenario_never_asks_for_a_priority(
    scheduler: Scheduler, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "out.json"
    brief = ["--set", "run.episode_time=20ms", "--trials", "1", "--episodes", "1", "--quiet"]
    command = ["run", str(SCENARIOS / "stopping.toml"), *brief, "--set", "realtime.priority=30", "--json", str(out)]
    assert main(command) == 0
    assert scheduler.calls == []
    assert "note: the scheduling priority 30 is not asked for" in capsys.readouterr().err
    assert json.loads(out.read_text())["realtime"]["granted"] == []


@pytest.mark.parametrize(("period", "told"), [("0", True), ("10ms", False)])
def test_check_tells_that_a_busy_loop_gets_no_priority(
    capsys: pytest.CaptureFixture[str], period: str, told: bool
) -> None:
    settings = ["--set", "realtime.priority=30", "--set", f"schedule.period={period}"]
    assert main(["check", str(SCENARIOS / "stopping.toml"), *settings]) == 0
    assert ("it gets no realtime.priority" in capsys.readouterr().out) == told


def test_a_signal_ends_a_run_on_uvloop_safely() -> None:
    run = ["--trials", "1", "--episodes", "20", "--set", "run.episode_time=300ms"]
    stopping = str(SCENARIOS / "stopping.toml")
    command = [sys.executable, "-m", "rtagent", "run", stopping, *run, "--set", "realtime.uvloop=true"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while "episode 1 of 20" not in process.stdout.readline():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=20)
    assert process.returncode == 1
    assert "stopped by signal: SIGINT" in err
    assert "All devices were made safe." in err


def test_every_key_of_the_table_is_on_the_page_on_scenarios() -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text()
    assert [key for key in RealtimeTable.model_fields if f"| `{key}` |" not in page] == []
    assert list(RealtimeTable.model_fields) == list(Realtime.__dataclass_fields__)


def test_the_watch_measures_what_this_thread_computes() -> None:
    began = RealClock.computed()
    time.sleep(0.05)
    slept = RealClock.computed() - began
    while RealClock.computed() - began < 20 * ms:
        pass
    assert slept < 10 * ms
