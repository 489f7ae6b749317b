"""What this machine and this installation allow: one finding each, with its problem and cure where it has one."""

from __future__ import annotations

import gc
import glob
import importlib.metadata
import os
import platform
import re
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from rtagent import __version__, kernels, plugins
from rtagent.errors import PluginError
from rtagent.finding import Finding
from rtagent.memory import available_memory, describe_size
from rtagent.realtime import machine, timeslice
from rtagent.units import describe

LITTLE_MEMORY = 500e6
SERIAL_GROUPS = ("dialout", "uucp")
SERIAL_PORTS = ("/dev/ttyUSB*", "/dev/ttyACM*", "/dev/serial/by-id/*")
CPU = Path("/sys/devices/system/cpu")
KERNEL = Path("/proc/sys/kernel")


def findings() -> Iterator[Finding]:
    """Yield all that is found without measuring."""
    for find in FINDINGS:
        try:
            yield find()
        except Exception as error:  # one that cannot be looked for must not hide the others
            name = find.__name__.strip("_").replace("_", " ")
            yield Finding(name, "unknown").but(error, f"it could not be looked for: {error!r}.", "none is known.")


def _python() -> Finding:
    return Finding("python", f"{platform.python_version()} ({platform.python_implementation()}), {sys.executable}")


def _rtagent() -> Finding:
    broken = [problem for group in plugins.GROUPS for problem in _broken_plugins(group)]
    found = Finding("rtagent", __version__, essential=True)
    return found.but(broken, " ".join(broken), "install these packages again.")


def _broken_plugins(group: str) -> Iterator[str]:
    for name in plugins.names(group):
        try:
            plugins.load(group, name)
        except PluginError as error:
            yield str(error)


def _numpy() -> Finding:
    return Finding("numpy", _version("numpy"))


def _numba() -> Finding:
    version = _version("numba")
    found = Finding("numba", version or "missing")
    return found.but(not version, "features and learners are 10 to 100 times slower.", "pip install numba.")


def _kernels() -> Finding:
    sources = [path for path in Path(kernels.__file__).parent.glob("*.py") if "@kernel(" in path.read_text("utf-8")]
    kept = [path for path in sources if _is_kept(path)]
    rest = "" if len(kept) == len(sources) else "; the others will be when they are first used"
    return Finding("kernels", f"{len(kept)} of {len(sources)} compiled{rest}")


def _is_kept(source: Path) -> bool:
    """Whether numba keeps compiled functions for this version of Python that are newer than their source."""
    folders = [source.parent / "__pycache__", *map(Path, filter(None, [os.environ.get("NUMBA_CACHE_DIR")]))]
    version = f"py{sys.version_info.major}{sys.version_info.minor}"
    indices = (path for folder in folders for path in folder.rglob(f"{source.stem}.*.{version}*.nbi"))
    return any(path.stat().st_mtime >= source.stat().st_mtime for path in indices)


def _uvloop() -> Finding:
    return Finding("uvloop", _version("uvloop") or "missing (realtime.uvloop wants it: pip install uvloop)")


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _processors() -> Finding:
    if not hasattr(os, "sched_getaffinity"):
        return Finding("processors", str(os.cpu_count()))
    bound, there = _numbers(os.sched_getaffinity(0)), _numbers(machine.available_processors())
    isolated = _read(CPU / "isolated")
    value = f"{there}; this program on {bound}" + (f"; isolated: {isolated}" if isolated else "")
    return Finding("processors", value)


def _numbers(processors: set[int]) -> str:
    return ", ".join(map(str, sorted(processors)))


def _kernel() -> Finding:
    version = re.findall(r"PREEMPT\w*", _read(Path("/proc/version")))
    chosen = re.findall(r"\((\w+)\)", _read(Path("/sys/kernel/debug/sched/preempt")))
    model = "PREEMPT_RT" if _read(Path("/sys/kernel/realtime")) == "1" else " ".join([*version[:1], *chosen])
    return Finding("kernel", f"{platform.system()} {platform.release()}, preemption {model or 'unknown'}")


def _inside() -> Finding:
    container = any(mark.exists() for mark in machine.CONTAINER_MARKS)
    virtual = " hypervisor" in _read(Path("/proc/cpuinfo"))
    places = ["a container"] * container + ["a virtual machine"] * virtual
    found = Finding("runs in", " in ".join(places) or "no container or virtual machine that shows")
    problem = "the host may stop it for milliseconds at any time, which no setting here prevents."
    return found.but(virtual, problem, "run robots from a machine of their own.")


def _priority() -> Finding:
    refusal = _refusal(lambda: machine.fifo(1))
    value = f"{'refused' if refusal else 'allowed'}; limit rtprio {_limit('RLIMIT_RTPRIO')}"
    runtime, period = (_read(KERNEL / f"sched_rt_{name}_us") for name in ("runtime", "period"))
    if runtime.lstrip("-").isdigit() and period.isdigit():
        share = "never throttled" if int(runtime) < 0 else f"throttled above {int(runtime) / int(period):.0%}"
        value += f"; a busy loop is {share}"
    return Finding("priority", value).but(refusal, *_split(refusal))


def _memory_lock() -> Finding:
    allowed = machine.may_lock_memory()
    value = f"{'allowed' if allowed else 'refused'}; limit memlock {_limit('RLIMIT_MEMLOCK', size=True)}"
    cure = machine.permission("ipc_lock", "memlock unlimited")
    return Finding("memory lock", value).but(not allowed, "realtime.lock_memory would be refused.", cure)


def _refusal(ask: Callable[[], machine.Undo]) -> str:
    """Return why a manner is refused, or nothing; it is tried in a thread that ends with what it was given."""
    refused: list[str] = []

    def attempt() -> None:
        try:
            ask()
        except machine.RefusedError as refusal:
            refused.append(str(refusal))

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    return "".join(refused)


def _split(refusal: str) -> tuple[str, str]:
    """Return the problem and the cure of a sentence `problem: cure`."""
    problem, _, cure = refusal.partition(": ")
    return f"{problem}.", cure


def _limit(name: str, *, size: bool = False) -> str:
    import resource

    number = getattr(resource, name, None)
    if number is None:
        return "unknown"
    limit = resource.getrlimit(number)[0]
    if limit == resource.RLIM_INFINITY:
        return "unlimited"
    return describe_size(limit) if size else str(limit)


def _governor() -> Finding:
    governors = sorted({_read(path) for path in CPU.glob("cpu[0-9]*/cpufreq/scaling_governor")} - {""})
    found = Finding("governor", ", ".join(governors) or "unknown: the machine does not show it")
    problem = "processors slow down while they wait, so that the next event is handled later."
    return found.but(set(governors) - {"performance"}, problem, "sudo cpupower frequency-set -g performance.")


def _idle_states() -> Finding:
    states = [
        f"{_read(state / 'name')} ({_read(state / 'latency')} µs)"
        for state in sorted(CPU.glob("cpu0/cpuidle/state*"))
        if _read(state / "disable") != "1"
    ]
    driver = _read(CPU / "cpuidle/current_driver")
    return Finding("idle states", (", ".join(states) or "unknown") + (f"; driver {driver}" if driver else ""))


def _timer_slack() -> Finding:
    slack = _read(Path("/proc/self/timerslack_ns"))
    value = f"{describe(int(slack))}; 1 ns in a real run" if slack.isdigit() else "unknown"
    return Finding("timer slack", value)


def _time_slice() -> Finding:
    usual = timeslice.time_slice()
    value = (
        f"{describe(usual)}; {describe(timeslice.SHORTEST)} in a real run" if usual else "the same for all threads"
    )
    problem = "a run wakes late, by milliseconds at times, where other programs keep all processors busy."
    cure = "use Linux 6.12 or later, or ask for a priority: [realtime] priority."
    return Finding("time slice", value).but(not usual, problem, cure)


def _python_settings() -> Finding:
    gil = getattr(sys, "_is_gil_enabled", lambda: True)()
    switch = describe(sys.getswitchinterval() * 1e9) if gil else "no GIL"
    collection = f"from {gc.get_threshold()[0]} objects on" if gc.isenabled() else "off"
    return Finding("interpreter", f"switch interval {switch}; garbage collection {collection}")


def _memory() -> Finding:
    available = available_memory()
    found = Finding("free memory", "unknown" if available is None else describe_size(available))
    return found.but(
        available is not None and available < LITTLE_MEMORY, "that is little.", "close other programs."
    )


def _load() -> Finding:
    busy, processors = os.getloadavg()[0], os.cpu_count() or 1
    found = Finding("load", f"{busy:.2g} of {processors}")
    return found.but(
        busy > processors, "other programs keep all processors busy.", "end them, or bind them to a few processors."
    )


def _serial_ports() -> Finding:
    ports = sorted(port for pattern in SERIAL_PORTS for port in glob.glob(pattern))  # noqa: PTH207  # absolute
    closed = [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    member = [name for name in SERIAL_GROUPS if name in _groups()]
    found = Finding(
        "serial ports", f"{', '.join(ports) or 'none'}; member of {', '.join(member) or 'no group of theirs'}"
    )
    cure = f"sudo usermod -aG {SERIAL_GROUPS[0]} $USER, and log in anew."
    return found.but(closed, f"{', '.join(closed)} cannot be opened.", cure)


def _groups() -> set[str]:
    import grp

    return {group.gr_name for group in grp.getgrall() if group.gr_gid in {*os.getgroups(), os.getegid()}}


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


FINDINGS: tuple[Callable[[], Finding], ...] = (
    _python, _rtagent, _numpy, _numba, _kernels, _uvloop, _processors, _load, _memory, _kernel, _inside,
    _priority, _memory_lock, _governor, _idle_states, _timer_slack, _time_slice, _python_settings, _serial_ports,
)  # fmt: skip
