"""`rtagent doctor`: its findings, each problem with its cure, latencies measured, exit codes, JSON."""

from __future__ import annotations

import gc
import json
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rtagent import clock, kernels, latency, ms, us
from rtagent.__main__ import main
from rtagent.commands import doctor, findings
from rtagent.commands.findings import Finding
from rtagent.errors import PluginError
from rtagent.realtime import Realtime, machine
from rtagent.summary import Summary

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="most of what it looks for is Linux's")

NAMES = {
    "python", "rtagent", "numpy", "numba", "kernels", "uvloop", "processors", "load", "free memory", "kernel",
    "runs in", "priority", "memory lock", "governor", "idle states", "timer slack", "time slice", "interpreter",
    "serial ports",
}  # fmt: skip
QUICK = Summary(100, 30e3, 50e3, 60e3, 70e3)
SLOW = Summary(100, 30e3, 1e6, 2e6, 3e6)


def found(name: str) -> Finding:
    return {finding.name: finding for finding in findings.findings()}[name]


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> Callable[[Summary], None]:
    """Let the doctor measure this and nothing else."""

    def measure(summary: Summary) -> None:
        both = {"sleep": summary, "event": summary}
        monkeypatch.setattr(doctor, "measure", lambda ways, duration: dict.fromkeys(ways, both))

    measure(QUICK)
    return measure


@pytest.fixture
def file_with(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Let a file of the machine hold another text."""
    texts: dict[str, str] = {}
    read = findings._read
    monkeypatch.setattr(findings, "_read", lambda path: texts.get(str(path), read(path)))
    return lambda path, text: texts.update({path: text})


# The command, as a user runs it


@pytest.mark.slow
def test_the_doctor_measures_this_machine_and_writes_json() -> None:
    command = [sys.executable, "-m", "rtagent", "doctor", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    told = json.loads(done.stdout)
    assert {finding["name"] for finding in told["findings"]} == NAMES | {"sleep latency", "event latency"}
    assert all(bool(finding["problem"]) == bool(finding["cure"]) for finding in told["findings"])
    assert {"as it is", "uvloop"} <= told["latency"].keys() <= {"as it is", "uvloop", "priority 50"}
    for kinds in told["latency"].values():
        assert kinds.keys() == {"sleep", "event"}
        for times in kinds.values():
            assert times["count"] > 100
            assert 0 <= times["median_s"] <= times["p99_s"] <= times["max_s"]


def test_the_doctor_prints_a_line_for_each_finding_and_a_table(
    measured: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    for name in NAMES:
        assert re.search(rf"^{name} +\S", out, re.MULTILINE), name
    assert re.search(r"^sleep of 1 ms, late by +as it is +100 +30 µs +60 µs +70 µs", out, re.MULTILINE)
    assert out.count("problem:") == out.count("cure:")


def test_a_problem_has_its_cure_beside_it(
    measured: Callable[[Summary], None], capsys: pytest.CaptureFixture[str]
) -> None:
    measured(SLOW)
    assert main(["doctor"]) == 0
    lines = capsys.readouterr().out.splitlines()
    place = next(number for number, line in enumerate(lines) if line.startswith("event latency"))
    assert lines[place].endswith("p99 2 ms")
    assert lines[place + 1].strip() == "problem: one in a hundred is more than a millisecond late."
    assert lines[place + 2].strip().startswith("cure: end other programs")


@pytest.mark.parametrize("error", [TimeoutError(), FileNotFoundError(2, "no python")])
def test_latency_that_cannot_be_measured_is_essential(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: OSError
) -> None:
    def fail(ways: object, duration: object) -> Any:
        raise error

    monkeypatch.setattr(doctor, "measure", fail)
    assert main(["doctor", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["latency"] == {}
    assert told["findings"][-1]["name"] == "latency"
    assert repr(error) in told["findings"][-1]["problem"]


def test_a_plugin_that_cannot_be_loaded_is_essential(
    monkeypatch: pytest.MonkeyPatch, measured: object, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(group: str, name: str) -> Any:
        raise PluginError(f"the plug-in {name!r} is broken.")

    monkeypatch.setattr("rtagent.plugins.load", broken)
    assert main(["doctor"]) == 1
    assert "the plug-in 'stopping' is broken." in capsys.readouterr().out


def test_only_manners_that_are_granted_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(priority: int) -> machine.Undo:
        raise machine.RefusedError("the scheduling priority 50 was refused: ask.")

    monkeypatch.setattr(machine, "fifo", refuse)
    monkeypatch.setattr(machine, "uvloop_maker", lambda: refuse(50))
    assert doctor._ways() == {"as it is": Realtime()}


# Findings


def test_one_finding_that_fails_does_not_hide_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    def _no_such_thing() -> Finding:
        raise RuntimeError("gone")

    monkeypatch.setattr(findings, "FINDINGS", (_no_such_thing, *findings.FINDINGS))
    first, *others = findings.findings()
    assert first.name == "no such thing"
    assert "RuntimeError('gone')" in first.problem
    assert {finding.name for finding in others} == NAMES


def test_a_refused_priority_is_found_with_its_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(pid: int, policy: int, parameters: os.sched_param) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(machine, "CONTAINER_MARKS", ())
    monkeypatch.setattr(resource, "getrlimit", lambda which: (0, 0))
    priority = found("priority")
    assert priority.value.startswith("refused; limit rtprio 0")
    assert priority.problem == "the scheduling priority 1 was refused."
    assert priority.cure.startswith("allow it with `sudo setcap cap_sys_nice+ep")


def test_looking_whether_a_priority_is_allowed_leaves_this_thread_as_it_is() -> None:
    before = os.sched_getscheduler(0)
    found("priority")
    assert os.sched_getscheduler(0) == before


@pytest.mark.parametrize(("runtime", "told"), [("950000", "throttled above 95%"), ("-1", "never throttled")])
def test_how_the_kernel_treats_a_busy_loop_is_told(
    file_with: Callable[[str, str], None], runtime: str, told: str
) -> None:
    file_with("/proc/sys/kernel/sched_rt_runtime_us", runtime)
    file_with("/proc/sys/kernel/sched_rt_period_us", "1000000")
    assert told in found("priority").value


@pytest.mark.parametrize(
    ("limit", "told"), [(8 << 20, "refused; limit memlock 8.39 MB"), (resource.RLIM_INFINITY, "allowed")]
)
def test_whether_memory_may_be_locked_is_told(monkeypatch: pytest.MonkeyPatch, limit: int, told: str) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit, limit))
    monkeypatch.setattr(machine, "capabilities", lambda: 0)
    lock = found("memory lock")
    assert lock.value.startswith(told)
    assert bool(lock.cure) == told.startswith("refused")


@pytest.mark.parametrize(("governor", "wrong"), [("powersave", True), ("performance", False)])
def test_a_governor_that_slows_processors_down_is_a_problem(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, governor: str, wrong: bool
) -> None:
    for number in range(2):
        folder = tmp_path / f"cpu{number}" / "cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(f"{governor}\n")
    monkeypatch.setattr(findings, "CPU", tmp_path)
    told = found("governor")
    assert told.value == governor
    assert ("cpupower" in told.cure) == wrong


def test_idle_states_are_those_that_are_not_disabled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for number, (name, delay, disabled) in enumerate([("POLL", 0, 0), ("C1", 2, 0), ("C6", 133, 1)]):
        folder = tmp_path / "cpu0" / "cpuidle" / f"state{number}"
        folder.mkdir(parents=True)
        for file, value in (("name", name), ("latency", delay), ("disable", disabled)):
            (folder / file).write_text(f"{value}\n")
    monkeypatch.setattr(findings, "CPU", tmp_path)
    assert found("idle states").value == "POLL (0 µs), C1 (2 µs)"


@pytest.mark.parametrize(
    ("path", "text", "told"),
    [
        ("/sys/kernel/realtime", "1", "preemption PREEMPT_RT"),
        ("/sys/kernel/debug/sched/preempt", "none (voluntary) full", "voluntary"),
        ("/proc/version", "Linux version 6.1 #1 SMP PREEMPT_DYNAMIC", "PREEMPT_DYNAMIC"),
    ],
)
def test_the_preemption_model_is_read(
    file_with: Callable[[str, str], None], path: str, text: str, told: str
) -> None:
    file_with(path, text)
    assert told in found("kernel").value


def test_a_virtual_machine_in_a_container_is_told(
    file_with: Callable[[str, str], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file_with("/proc/cpuinfo", "flags : fpu hypervisor lahf_lm")
    monkeypatch.setattr(machine, "CONTAINER_MARKS", (tmp_path,))
    assert found("runs in").value == "a container in a virtual machine"
    file_with("/proc/cpuinfo", "flags : fpu lahf_lm")
    monkeypatch.setattr(machine, "CONTAINER_MARKS", ())
    assert (found("runs in").value, found("runs in").problem) == ("no container or virtual machine that shows", "")


def test_a_missing_compiler_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    version = findings._version
    monkeypatch.setattr(findings, "_version", lambda name: "" if name in ("numba", "uvloop") else version(name))
    assert (found("numba").value, found("numba").cure) == ("missing", "pip install numba.")
    assert "pip install uvloop" in found("uvloop").value
    assert re.match(r"\d+\.\d+", found("numpy").value)


def test_kernels_are_found_compiled_unless_their_source_is_newer(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source = tmp_path / "fast.py"
    source.write_text("@kernel()\ndef f(): ...\n")
    monkeypatch.setattr(kernels, "__file__", str(tmp_path / "__init__.py"))
    assert found("kernels").value == "0 of 1 compiled; the others will be when they are first used"
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    index = cache / f"fast.f-2.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    index.touch()
    assert found("kernels").value == "1 of 1 compiled"
    os.utime(index, (0, 0))
    assert found("kernels").value.startswith("0 of 1")


def test_a_serial_port_that_cannot_be_opened_is_a_problem(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    monkeypatch.setattr(findings, "SERIAL_PORTS", (f"{tmp_path}/ttyUSB*",))
    assert found("serial ports").value.startswith("none; member of")
    port.touch()
    monkeypatch.setattr(os, "access", lambda path, mode: path != str(port))
    assert found("serial ports").problem == f"{port} cannot be opened."
    assert "usermod -aG dialout" in found("serial ports").cure


@pytest.mark.parametrize(("available", "little"), [(100e6, True), (8e9, False), (None, False)])
def test_little_free_memory_is_a_problem(
    monkeypatch: pytest.MonkeyPatch, available: float | None, little: bool
) -> None:
    monkeypatch.setattr(findings, "available_memory", lambda: available)
    assert bool(found("free memory").problem) == little


def test_the_settings_of_the_interpreter_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "getswitchinterval", lambda: 2e-4)
    assert found("interpreter").value.startswith("switch interval 200 µs; garbage collection from ")
    monkeypatch.setattr(gc, "isenabled", lambda: False)
    assert found("interpreter").value.endswith("garbage collection off")


# Latency


@pytest.mark.slow
def test_lateness_is_what_the_loop_was_blocked_for() -> None:
    """Sleeps and events on a loop that computes for 8 ms at a time are late by some of that."""
    import asyncio

    async def blocked(kind: Callable[[int], Any]) -> list[int]:
        async def block() -> None:
            while True:
                await clock.current().compute(8 * ms)
                await asyncio.sleep(0.002)

        blocking = asyncio.create_task(block())
        late: list[int] = await kind(100 * ms)
        blocking.cancel()
        return late

    for kind in (latency.sleeps, latency.events):
        late = clock.run(blocked(kind), "real")
        assert min(late) >= 0
        assert max(late) > 3 * ms


@pytest.mark.slow
def test_the_number_of_sleeps_and_events_is_as_it_should_be() -> None:
    both = latency.measure({"as it is": Realtime(), "other": Realtime(switch_interval=50 * us)}, 80 * ms)
    assert list(both) == ["as it is", "other"]
    for kinds in both.values():
        assert kinds["sleep"].count == 40
        assert 10 <= kinds["event"].count <= 40


def test_a_sender_that_does_not_start_gives_no_events(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "SENDER", "raise SystemExit")
    with pytest.raises(OSError, match="sent nothing"):
        latency.measure({"as it is": Realtime()}, 40 * ms)


def test_a_sender_that_never_ends_is_given_up_and_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "SENDER", "import time; time.sleep(100)")
    monkeypatch.setattr(latency, "PATIENCE", 100 * ms)
    with pytest.raises(TimeoutError):
        latency.measure({"as it is": Realtime()}, 40 * ms)
