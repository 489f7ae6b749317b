"""The life of a run: open the devices, run the trials, and end safely on every way out."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.random import Generator

from rtagent.agent import Agent
from rtagent.checkpoint.keeper import Keeper
from rtagent.clock import current
from rtagent.costs import Costs
from rtagent.device import Device, Foreseeing
from rtagent.errors import (
    ClockError,
    DeviceError,
    LimitError,
    RtagentError,
    RunStuckError,
    ScheduleError,
)
from rtagent.guard import HangGuard
from rtagent.instruments import Hooks
from rtagent.keeping import Keeping
from rtagent.latch import Latch
from rtagent.protection import WATCHDOG, Protection, Watchdog
from rtagent.recorder import Fault, Recorder
from rtagent.result import LEARNING, Result, RunError
from rtagent.runtime import NO_HABITS, Habits, Limits, Runtime, agent_prologue
from rtagent.schedule import Schedule
from rtagent.shutdown import close_all, make_all_safe
from rtagent.streams import stream
from rtagent.supervision import SupervisedDevice, Supervision
from rtagent.task import Task
from rtagent.units import ms, second
from rtagent.urgency import check_urgency

GIVE_UP_TIMEOUT = 1 * second
"""A run that was told to stop, and waits for something that does not yield, is left behind after this."""

SUSPENSION = 100 * ms
"""So long a suspension makes samples stale; it is looked for as often."""

AgentMaker = Callable[[Generator], Agent]


@dataclass(frozen=True)
class Plan:
    """How much to run, from which seed; `drain` (ns) bounds learning after a signal or a fault."""

    trials: int = 1
    episodes: int = 1
    seed: int = 0
    limits: Limits = field(default_factory=Limits)
    drain: int = 500 * ms


async def run(
    devices: Mapping[str, Device],
    task: Task,
    agent: Agent | AgentMaker,
    schedule: Schedule,
    plan: Plan = Plan(),  # frozen: sharing it changes nothing
    *,
    costs: Costs | None = None,
    supervision: Mapping[str, Supervision] | None = None,
    instruments: Iterable[object] = (),
    habits: Habits = NO_HABITS,
    latch: Latch | None = None,
    watchdog: Watchdog = WATCHDOG,
    keeper: Keeper | None = None,
) -> Result:
    """Run a whole plan under the clock of the running event loop, and return what it came to.

    `agent` is an agent, or what makes one from a random generator: each trial begins with a new one.
    `costs` (virtual clock only) are what components cost. Tripping `latch` stops the run; `watchdog` is for runs
    with guarded devices. `keeper` keeps checkpoints, and has the one to go on from.

    Raises `RunError`, which carries the result so far, when the run was stopped, a device died, or something
    raised; `ScheduleError`, `SpecError`, `RunStuckError` or `CheckpointError` before anything is opened when the
    parts do not fit, and `StoppedError` where hardware is latched. In every case the devices have been made safe.
    """
    supervision, hooks, latch = supervision or {}, Hooks(instruments), latch or Latch()
    life = _Life(
        devices, task, agent, schedule, plan, costs or {}, supervision, hooks, habits, latch, watchdog, keeper
    )
    return await life.live()


@dataclass(frozen=True)
class _End:
    """Why a run ended before its time."""

    source: str
    message: str
    error: BaseException | None = None

    def trace(self) -> str:
        if self.error is None or isinstance(self.error, RtagentError | asyncio.CancelledError):
            return ""
        return "".join(traceback.format_exception(self.error))


class _Life:
    def __init__(
        self,
        devices: Mapping[str, Device],
        task: Task,
        agent: Agent | AgentMaker,
        schedule: Schedule,
        plan: Plan,
        costs: Costs,
        supervision: Mapping[str, Supervision],
        hooks: Hooks,
        habits: Habits,
        latch: Latch,
        watchdog: Watchdog,
        keeper: Keeper | None,
    ) -> None:
        self._task, self._make_agent, self._schedule, self._plan = task, _maker(agent, plan), schedule, plan
        self._costs, self._hooks, self._habits = costs, hooks, habits
        self._clock = current()
        self._guard = HangGuard(self._clock)
        self._recorder = Recorder()
        self._began = self._clock.now()
        self._latch = latch
        self._protection = Protection(devices, watchdog, latch, lambda said: self._report("watchdog", said))
        if self._clock.virtual and self._protection.needed:
            raise ClockError("hardware knows no virtual clock: run it under the real one, or take its fake.")
        self._devices = {
            name: self._supervised(name, device, supervision.get(name, Supervision()))
            for name, device in devices.items()
        }
        self._agents: list[Agent] = []
        self._running: Runtime | None = None
        self._first_agent = self._make_agent(stream(plan.seed, "policy", 0))
        agent_prologue(schedule, self._first_agent)  # so that what does not fit is told before anything is opened
        self._not_safe: list[str] = []
        self._bind_task()
        if self._clock.virtual:
            refuse_stuck(devices, schedule, costs, plan)
        self._keeping = Keeping(keeper, plan, self._clock, self._recorder, self._devices, self._agents)
        self._keeping.begin(self._report)
        self._keeping.take_agent(self._first_agent, 0)
        self._began = self._keeping.began

    def _supervised(self, name: str, device: Device, supervision: Supervision) -> SupervisedDevice:
        return SupervisedDevice(
            name,
            device,
            supervision,
            self._clock,
            self._guard,
            self._latch,
            self._report,
            self._protection.renew,
        )

    def _bind_task(self) -> None:
        specs = {name: device.supervision.spec_of(device.device) for name, device in self._devices.items()}
        self._task.bind(specs)
        check_urgency(self._schedule, self._task, self._first_agent.learner, specs)

    async def live(self) -> Result:
        self._hooks.call("run_began", self._report)
        self._hooks.call("counting_began", self._counts)
        work = asyncio.ensure_future(self._work())
        try:
            with _signals(self._latch), _heard(self._latch) as stopped:
                end = await self._until_end(work, stopped)
                ended = self._clock.now()
                work.cancel()
                await self._make_safe(end)
                await asyncio.wait({work}, timeout=GIVE_UP_TIMEOUT / second)
                await self._keeping.run_ended(broken_off=end is not None and end.source != "run")
                await self._drain(end)
        except asyncio.CancelledError:
            work.cancel()
            await self._make_safe(_End("run", "the run was cancelled"))
            raise
        finally:
            self._guard.close()
            if self._running is not None:
                self._running.work.close()
        return self._conclude(end, ended)

    async def _work(self) -> None:
        agents = self._make_agents()
        if self._protection.needed:
            agents = iter(list(agents))  # making one may keep the loop from its devices and heartbeats
        for device in self._devices.values():
            await device.open()
        if self._protection.needed:
            await self._protection.arm()
            for device in self._devices.values():
                await device.first_sample()
            self._protection.begun = True
        for trial, agent in enumerate(agents):
            self._agents.append(agent)
            if self._keeping.is_over(trial):
                continue
            runtime = self._running = self._runtime(agent, trial)
            self._hooks.call("trial_began", trial, agent)
            for episode in range(await self._keeping.go_on(runtime, trial), self._plan.episodes):
                rngs = {name: stream(self._plan.seed, "device", name, trial, episode) for name in self._devices}
                await runtime.run_episode(trial, episode, rngs)
                await self._keeping.episode_ended(trial, episode)
            if trial < self._plan.trials - 1:
                await runtime.drain(None)
                self._hooks.call("trial_ended", trial, agent)

    def _make_agents(self) -> Iterator[Agent]:
        """Make an agent for each trial, when it is asked for."""
        yield self._first_agent
        for trial in range(1, self._plan.trials):
            agent = self._make_agent(stream(self._plan.seed, "policy", trial))
            self._keeping.take_agent(agent, trial)
            yield agent

    def _runtime(self, agent: Agent, trial: int) -> Runtime:
        return Runtime(
            self._devices,
            self._task,
            agent,
            self._schedule,
            clock=self._clock,
            recorder=self._recorder,
            hooks=self._hooks,
            costs=self._costs,
            costs_rng=stream(self._plan.seed, "costs", trial),
            ordering_rng=stream(self._plan.seed, "ordering", trial),
            limits=self._plan.limits,
            learning_failed=self._learning_failed,
            habits=self._keeping.habits(self._habits),
        )

    async def _until_end(self, work: asyncio.Future[None], stopped: asyncio.Future[None]) -> _End | None:
        """Wait for the work's own end, a stop, a call that never returns, or the end of a suspension."""
        suspended = asyncio.ensure_future(self._until_suspended())
        ends: set[asyncio.Future[Any]] = {work, stopped, self._guard.stuck, suspended}
        await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        suspended.cancel()
        error = work.exception() if work.done() and not work.cancelled() else None
        if isinstance(error, LimitError):
            self._latch.trip("limit", str(error))
        if self._latch.tripped:
            return _End("stop", str(self._latch.error()), error)
        if error is not None:
            return _End("device" if isinstance(error, DeviceError) else "run", _sentence(error), error)
        if self._guard.stuck.done():
            return _End("device", f"{self._guard.stuck.result()} did not return, not even when it was cancelled")
        if work.cancelled():
            return _End("run", "the run was cancelled")
        if work.done():
            return None
        return _End("machine", "the machine was suspended, so that all that was known of the world is stale")

    async def _until_suspended(self) -> None:
        """Return once the machine has been suspended and has come back (under the virtual clock: never)."""
        if self._clock.virtual:
            await asyncio.get_running_loop().create_future()
        before = self._clock.suspended()
        while self._clock.suspended() - before < SUSPENSION:  # noqa: ASYNC110  # the kernel sends no event
            await asyncio.sleep(SUSPENSION / second)

    async def _make_safe(self, end: _End | None) -> None:
        """Make every device safe, those that fail by the watchdog; close them, and end their protection."""
        devices = list(self._devices.values())
        failed = await make_all_safe(devices)
        self._not_safe = await self._protection.save(failed)
        for sentence in failed.values():
            if sentence not in self._not_safe:
                self._report("stop", f"{sentence} The watchdog made it safe.")
        self._not_safe += await close_all(devices)
        await self._protection.end(end.message if end else " ".join(self._not_safe))

    async def _drain(self, end: _End | None) -> None:
        """Learn what is still in the queue: all on a normal end, else for a bounded time."""
        if self._running is None:
            return
        may_learn = end is None or end.source != "run"
        bounded = self._clock.now() + (self._plan.drain if may_learn else 0)
        await self._running.drain(None if end is None else bounded)
        self._hooks.call("trial_ended", len(self._agents) - 1, self._agents[-1])

    def _learning_failed(self, error: BaseException) -> None:
        """Note that learning is over; the run goes on with the weights it has."""
        message = f"learning raised {_sentence(error).rstrip('.')}; the run went on with the weights that it had"
        now, trace = self._clock.now(), "".join(traceback.format_exception(error))
        self._recorder.fault(Fault(now - self._began, LEARNING, message, False, trace))
        self._hooks.call("fault", LEARNING, message, now)

    def _counts(self) -> Mapping[str, int]:
        """Return what was counted so far, that of a device under its name."""
        counts = dict(self._recorder.counters)
        for name, device in self._devices.items():
            counts |= {f"{name}.{what}": count for what, count in device.counters.items()}
        return counts

    def _conclude(self, end: _End | None, ended: int) -> Result:
        self._recorder.counters["instruments_removed"] += len(self._hooks.removed)
        for sentence in self._hooks.removed:
            self._report("instrument", sentence)
        for sentence in self._not_safe:
            self._report("stop", sentence)
        if end is not None:
            self._recorder.fault(Fault(ended - self._began, end.source, end.message, True, end.trace()))
            self._hooks.call("fault", end.source, end.message, ended)
        self._recorder.elapsed = self._clock.now() - self._began
        result = Result(
            self._plan.seed,
            "virtual" if self._clock.virtual else "real",
            self._schedule,
            self._recorder,
            {name: device.counters for name, device in self._devices.items()},
            self._agents,
            self._not_safe,
        )
        if end is not None:
            raise RunError(end.message, result) from end.error
        return result

    def _report(self, source: str, message: str) -> None:
        now = self._clock.now()
        self._recorder.fault(Fault(now - self._began, source, message))
        self._hooks.call("fault", source, message, now)


def _maker(agent: Agent | AgentMaker, plan: Plan) -> AgentMaker:
    if not isinstance(agent, Agent):
        return agent
    if plan.trials != 1:
        raise ScheduleError(f"{plan.trials} trials need a new agent each: give what makes one from a generator.")

    def the_same(rng: Generator) -> Agent:
        agent.rng = rng
        return agent

    return the_same


def _sentence(error: BaseException) -> str:
    if isinstance(error, RtagentError):
        return str(error)
    return f"{type(error).__name__}: {error}" if str(error) else type(error).__name__


def refuse_stuck(devices: Mapping[str, Device], schedule: Schedule, costs: Costs, plan: Plan) -> None:
    """Refuse a virtual run whose time could never advance; raise `RunStuckError`."""
    moves = schedule.learn_delay or schedule.period or any(cost.low or cost.high for cost in costs.values())
    foreseen = any(isinstance(device, Foreseeing) or device.spec.synchronous for device in devices.values())
    if not moves and not foreseen and not plan.limits.episode_time:
        raise RunStuckError(
            "virtual time could never advance: no component costs anything and no device knows its next event. "
            "Give a component a cost, or schedule.period or schedule.learn_delay a value."
        )


@contextlib.contextmanager
def _heard(latch: Latch) -> Iterator[asyncio.Future[None]]:
    """Give a future that is done once the latch is tripped."""
    loop = asyncio.get_running_loop()
    stopped: asyncio.Future[None] = loop.create_future()

    def stop() -> None:
        if not stopped.done():
            stopped.set_result(None)

    def hear() -> None:
        with contextlib.suppress(RuntimeError):  # the loop has just been closed
            loop.call_soon_threadsafe(stop)

    with latch.heard_by(hear):
        yield stopped


@contextlib.contextmanager
def _signals(latch: Latch) -> Iterator[None]:
    """Have SIGINT and SIGTERM trip the latch; only in the main thread can they."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: object) -> None:
        latch.trip("signal", signal.Signals(number).name)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
