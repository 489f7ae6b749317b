"""From a validated scenario to the parts of a run. Nothing is opened, nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any, TypeVar

from numpy.random import Generator

from rtagent import plugins
from rtagent.agent import Agent
from rtagent.checkpoint.keeper import Keeper
from rtagent.costs import Cost, Costs
from rtagent.device import Device, Finite, Guarded
from rtagent.errors import RtagentError, ScenarioError, SpecError
from rtagent.features import Composed, FeatureCoder, Inputs, PairedCoder
from rtagent.features.inputs import matching
from rtagent.latch import Latch
from rtagent.learn import Condition
from rtagent.learning import Horde, WithHorde
from rtagent.lifecycle import Plan, refuse_stuck, run
from rtagent.memory import available_memory, describe_size, ledger
from rtagent.policy import Policy
from rtagent.protection import Watchdog
from rtagent.realtime import Realtime
from rtagent.result import Result
from rtagent.runtime import NO_HABITS, Habits, Limits, agent_prologue
from rtagent.scenario.devices import build_device
from rtagent.scenario.load import Part, Scenario
from rtagent.scenario.model import InputTable
from rtagent.scenario.patience import check_tolerance, check_watchdog
from rtagent.scenario.source import KeyPath
from rtagent.schedule import PRESETS, Component, Order, Schedule, parse_order
from rtagent.specs import Spec
from rtagent.streams import stream
from rtagent.supervision import Supervision
from rtagent.task import Task
from rtagent.units import second
from rtagent.urgency import check_urgency

T = TypeVar("T")


@dataclass
class Assembly:
    """All that a run needs."""

    devices: dict[str, Device]
    task: Task
    make_agent: Callable[[Generator], Agent]
    schedule: Schedule
    prologue: Order
    plan: Plan
    costs: Costs
    supervision: dict[str, Supervision]
    memory: dict[str, int]
    """Bytes that an agent takes, by what they are for."""
    realtime: Realtime
    watchdog: Watchdog

    @property
    def never_sleeps(self) -> bool:
        """Whether its loop waits neither for a period nor for what comes from its devices by itself."""
        sampled = all(device.spec.rate for device in self.devices.values())
        return not (self.schedule.period or (sampled and self.schedule.observe == "fresh"))

    @property
    def guarded(self) -> bool:
        """Whether it moves something real, or what is emulated on the wire."""
        return any(isinstance(device, Guarded) for device in self.devices.values())

    @property
    def pause(self) -> float:
        """How long (ns) nothing new comes where observe waits for it, from the device that is sampled most often.

        It is 0 where observe does not wait, or a device has something new at any time.
        """
        rates = [device.spec.rate for device in self.devices.values()]
        waits = rates and self.schedule.observe == "fresh" and all(0 < rate < inf for rate in rates)
        return second / max(rates) if waits else 0.0

    async def run(
        self,
        instruments: Iterable[object] = (),
        habits: Habits = NO_HABITS,
        latch: Latch | None = None,
        keeper: Keeper | None = None,
    ) -> Result:
        """Run it under the clock of the running event loop; see `rtagent.run`."""
        return await run(
            self.devices,
            self.task,
            self.make_agent,
            self.schedule,
            self.plan,
            costs=self.costs,
            supervision=self.supervision,
            instruments=instruments,
            habits=habits,
            latch=latch,
            watchdog=self.watchdog,
            keeper=keeper,
        )


class _Problems:
    """Collects the sentences of the errors that building the parts raises."""

    def __init__(self, scenario: Scenario) -> None:
        self.sentences: list[str] = []
        self._source = scenario.source

    def attempt(self, path: KeyPath, make: Callable[[], T]) -> T | None:
        """Return what `make` makes, or None after noting why it could not."""
        try:
            return make()
        except Exception as error:  # a plug-in may raise anything
            said = str(error) if isinstance(error, RtagentError) else repr(error)
            self.sentences.append(f"{self._source.where(path)}: {'.'.join(map(str, path))}: {said}")
            return None


def assemble(scenario: Scenario) -> Assembly:
    """Build the parts of a scenario; raise `ScenarioError` with everything that does not fit together."""
    problems = _Problems(scenario)
    devices = {
        name: device
        for name, part in scenario.devices.items()
        if (device := problems.attempt(part.path, partial(build_device, part, scenario.model.run))) is not None
    }
    supervision = _supervision(scenario)
    specs = {
        name: spec
        for name, device in devices.items()
        if (spec := problems.attempt(("devices", name, "events"), partial(supervision[name].spec_of, device)))
    }
    complete = len(specs) == len(scenario.devices)
    task = problems.attempt(("task",), lambda: _build(scenario.parts["task"]))
    if task is not None and complete:
        problems.attempt(("task",), lambda: task.bind(specs))
    schedule = problems.attempt(("schedule",), lambda: _schedule(scenario))
    if schedule is not None:
        schedule = problems.attempt(_learn_path(scenario), partial(_with_learn, scenario, schedule))
    costs = problems.attempt(("costs",), lambda: _costs(scenario)) or {}
    make_agent = _AgentBuilder(scenario, task) if task is not None else None
    rng = stream(scenario.model.run.seed, "check")
    with ledger() as memory:
        agent = make_agent.attempt(problems, rng) if make_agent is not None else None
    before: Order = ()
    if schedule is not None and agent is not None:
        before = problems.attempt(("schedule",), partial(agent_prologue, schedule, agent)) or ()
        if task is not None and complete:
            check = partial(check_urgency, schedule, task, agent.learner, specs)
            problems.attempt(_learn_path(scenario), check)
    plan = problems.attempt(("run", "episodes"), lambda: _plan(scenario, devices)) or Plan()
    problems.attempt(("run", "trials"), lambda: _refuse_trials(plan.trials, sum(memory.values())))
    if schedule is not None:
        _check_patience(problems, scenario, devices, schedule)
    if schedule is not None and scenario.model.run.clock == "virtual" and complete:
        problems.attempt(("run", "clock"), partial(refuse_stuck, devices, schedule, costs, plan))
    if problems.sentences or task is None or make_agent is None or schedule is None:
        raise ScenarioError(problems.sentences)
    realtime, watchdog = _realtime(scenario), _watchdog(scenario)
    return Assembly(
        devices, task, make_agent, schedule, before, plan, costs, supervision, memory, realtime, watchdog
    )


def _check_patience(
    problems: _Problems, scenario: Scenario, devices: Mapping[str, Device], schedule: Schedule
) -> None:
    """Note where the watchdog, or hardware with one of its own, would take learning for a stall."""
    guarded = {name: device for name, device in devices.items() if isinstance(device, Guarded)}
    if guarded:
        timeout = scenario.model.watchdog.timeout
        problems.attempt(("watchdog", "timeout"), partial(check_watchdog, timeout, schedule))
    for name, device in guarded.items():
        problems.attempt(scenario.devices[name].path, partial(check_tolerance, device, schedule))


def _supervision(scenario: Scenario) -> dict[str, Supervision]:
    return {
        name: Supervision(table.supervision.timeout, table.supervision.stale_after, table.events)
        for name, table in scenario.model.devices.items()
    }


def _refuse_trials(trials: int, size: int) -> None:
    """Refuse more agents than fit into memory: the results keep the agent of each trial."""
    available = available_memory()
    if available is not None and trials * size > available:
        raise SpecError(
            f"the agents of {trials} trials take {describe_size(trials * size)}, "
            f"and this machine has {describe_size(available)} free: run fewer."
        )


def _build(part: Part, **context: Any) -> Any:
    return plugins.build(part.plugin, part.given(), **context)


class _AgentBuilder:
    """Builds agents from the tables of a scenario; each part under its own place, for its problems."""

    def __init__(self, scenario: Scenario, task: Task) -> None:
        self._scenario, self._parts, self._task = scenario, scenario.parts, task
        model = scenario.model
        self._coders = {"learner": _CoderBuilder(self._parts["features"], model.features.input, task)}
        if model.horde is not None:
            self._coders["horde"] = _CoderBuilder(self._parts["horde.features"], model.horde.features.input, task)

    def __call__(self, rng: Generator) -> Agent:
        """Make an agent; raise `ScenarioError` where that fails."""
        problems = _Problems(self._scenario)
        agent = self.attempt(problems, rng)
        if agent is None:
            raise ScenarioError(problems.sentences)
        return agent

    def attempt(self, problems: _Problems, rng: Generator) -> Agent | None:
        """Make an agent, noting what is wrong with each of its parts."""
        if problems.sentences and not self._task.state:
            return None  # a task may know its signals only when bound to devices that are right
        policy = problems.attempt(("policy",), self._policy)
        made = [self._attempt_learner(table, policy, problems) for table in self._coders]
        if None in made:
            return None
        (features, learner), *beside = filter(None, made)
        for horde_features, horde in beside:
            features = PairedCoder(features, horde_features)
            learner = problems.attempt(("horde",), partial(WithHorde, learner, horde))
        return None if learner is None else Agent(features, learner, policy, rng)

    def _policy(self) -> Policy | None:
        made: Policy | None = _build(self._parts["policy"]) if "policy" in self._parts else None
        return made

    def _attempt_learner(
        self, table: str, policy: Policy | None, problems: _Problems
    ) -> tuple[FeatureCoder, Any] | None:
        """Make the learner of a table, and the coder of its features."""
        features = self._coders[table].attempt(problems)
        if features is None or (policy is None and "policy" in self._parts):
            return None
        learner = problems.attempt((table,), lambda: self._learner(table, features, policy))
        return None if learner is None else (features, learner)

    def _learner(self, table: str, features: FeatureCoder, policy: Policy | None) -> Any:
        plugin = self._parts[table].plugin
        return _build(
            self._parts[table],
            size=features.size,
            active=features.active,
            actions=0 if policy is None and plugin is Horde else len(self._task.actions),
            state=self._task.state,
            policy=policy,
        )


class _CoderBuilder:
    """Builds a coder, behind its inputs if it has any, from its table."""

    def __init__(self, part: Part, table: InputTable | None, task: Task) -> None:
        self._part, self._input, self._task = part, table, task

    def attempt(self, problems: _Problems) -> FeatureCoder | None:
        """Make it, noting what is wrong, and each pattern that matches nothing."""
        table = self._input
        if table is None:
            return problems.attempt(self._part.path, lambda: self._coder(self._task.state))
        inputs = self._attempt_inputs(table, problems)
        if inputs is None:
            return None
        coder = problems.attempt(self._part.path, lambda: self._coder(inputs.specs))
        return None if coder is None else Composed(inputs, coder, bias=table.bias)

    def _coder(self, state: Mapping[str, Spec]) -> FeatureCoder:
        made: FeatureCoder = _build(self._part, state=state)
        return made

    def _attempt_inputs(self, table: InputTable, problems: _Problems) -> Inputs | None:
        path, before = (*self._part.path, "input"), len(problems.sentences)
        problems.attempt((*path, "signals"), partial(matching, table.signals, self._task.state))
        for number, each in enumerate(table.traces):
            at = (*path, "traces", number, "signals")
            problems.attempt(at, partial(matching, each.signals, self._task.state))
        return problems.attempt(path, lambda: self._inputs(table)) if len(problems.sentences) == before else None

    def _inputs(self, table: InputTable) -> Inputs:
        coder = self._part.settings
        for key, field in type(coder).model_fields.items():
            if key in ("outside", "bias") and getattr(coder, key) != field.default:
                where = ".".join(map(str, self._part.path))
                raise SpecError(f"{key} is set for the coder, behind its input: set it in [{where}.input] alone.")
        return Inputs(self._task.state, signals=table.signals, traces=table.traces, outside=table.outside)


def _schedule(scenario: Scenario) -> Schedule:
    table = scenario.model.schedule
    settings = {
        name: getattr(table, name) for name in ("learn_delay", "period", "overrun", "observe", "observe_timeout")
    }
    if table.preset is None:
        return Schedule(parse_order(table.order or ()), **settings)
    if table.ordering is not None and PRESETS[table.preset].ordering is not None:
        settings["ordering"] = table.ordering
    return Schedule.preset(table.preset, **settings)


def _learn_path(scenario: Scenario) -> KeyPath:
    """Return where a scenario says most about its learning rule."""
    said = scenario.model.learn.model_fields_set
    if not said:
        return ("schedule", "preset")
    return ("learn", next((key for key in ("urgent", "when") if key in said), "where"))


def _with_learn(scenario: Scenario, schedule: Schedule) -> Schedule:
    """Return the schedule with what the scenario says of its learning rule."""
    table = scenario.model.learn
    said = {name: getattr(table, name) for name in ("when", "slice", "where", "queue", "full")}
    given = {name: value for name, value in said.items() if value is not None}
    urgent = Condition(**table.urgent.model_dump(exclude_none=True)) if table.urgent else None
    return replace(schedule, learn=replace(schedule.learn, urgent=urgent, **given))


def _realtime(scenario: Scenario) -> Realtime:
    table = scenario.model.realtime
    return Realtime(**{name: getattr(table, name) for name in type(table).model_fields})


def _watchdog(scenario: Scenario) -> Watchdog:
    return Watchdog(scenario.model.watchdog.timeout, str(scenario.source.path.resolve()))


def _costs(scenario: Scenario) -> Costs:
    tables = {Component(name): table for name, table in scenario.model.costs if table is not None}
    return {component: Cost(table.low, table.high, table.distribution) for component, table in tables.items()}


def _plan(scenario: Scenario, devices: Mapping[str, Device]) -> Plan:
    table = scenario.model.run
    limits = Limits(table.episode_time, table.episode_steps)
    episodes = table.episodes
    if not episodes and len(devices) == len(scenario.devices):
        episodes = min((device.episodes for device in devices.values() if isinstance(device, Finite)), default=0)
        if not episodes:
            raise SpecError("0 episodes are all that a device has, but none here comes to an end: give a number.")
    return Plan(table.trials, episodes, table.seed, limits, scenario.model.stop.drain)
