"""`rtagent check`: validate scenarios and say what they would do; nothing is opened, nothing runs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from math import prod

from rtagent.commands.overrides import overrides
from rtagent.device import Noting
from rtagent.errors import ScenarioError
from rtagent.memory import describe_size
from rtagent.scenario import Assembly, Scenario, assemble, load
from rtagent.units import describe


def check_command(arguments: argparse.Namespace) -> int:
    """Check every file; return 0 where all are right, else 2."""
    code = 0
    for path in arguments.scenarios:
        try:
            scenario = load(path, overrides(path, arguments))
            assembly = assemble(scenario)
        except ScenarioError as error:
            sys.stderr.write(f"{error}\n")
            code = 2
        else:
            sys.stdout.write(
                "\n".join([f"{path}: right", *(f"  {line}" for line in explain(scenario, assembly)), ""])
            )
    return code


def explain(scenario: Scenario, assembly: Assembly) -> Iterator[str]:
    """Yield what a scenario would do, a line for each part, and what may surprise."""
    if scenario.model.description:
        yield scenario.model.description
    run = scenario.model.run
    yield f"{run.trials} × {assembly.plan.episodes} episodes, {run.clock} clock, seed {run.seed}"
    for name, device in assembly.devices.items():
        sensors, actuators = (
            ", ".join(device.spec.sensors) or "none",
            ", ".join(device.spec.actuators) or "none",
        )
        yield f"device {name} ({scenario.devices[name].name}): senses {sensors}; takes {actuators}"
    yield from device_notes(assembly)
    if assembly.guarded:
        yield f"a watchdog makes it safe when the event loop stalls for {describe(assembly.watchdog.timeout)}"
    yield f"task {scenario.parts['task'].name}: actions {', '.join(assembly.task.actions) or 'none'}"
    kinds = [scenario.parts[name].name for name in ("features", "learner", "policy") if name in scenario.parts]
    yield f"agent: {', '.join(kinds)}"
    if "horde" in scenario.parts:
        yield f"beside it a Horde, over {scenario.parts['horde.features'].name} features of its own"
    yield from _explain_memory(assembly.memory)
    yield from _explain_schedule(assembly)
    if (sweep := scenario.model.sweep) is not None:
        combinations = prod(map(len, sweep.over.values()))
        yield f"a sweep of {combinations} combinations, {sweep.trials} runs each, by rtagent sweep"
    yield from _warnings(scenario, assembly)


def device_notes(assembly: Assembly) -> Iterator[str]:
    """Yield what devices have to say before a run."""
    for name, device in assembly.devices.items():
        if isinstance(device, Noting):
            yield from (f"device {name}: {note}" for note in device.notes)


def _explain_memory(memory: Mapping[str, int]) -> Iterator[str]:
    if memory:
        parts = ", ".join(f"{describe_size(size)} for {what}" for what, size in memory.items())
        yield f"memory of an agent: {describe_size(sum(memory.values()))}: {parts}"


def _explain_schedule(assembly: Assembly) -> Iterator[str]:
    schedule = assembly.schedule
    first = f"first {', '.join(assembly.prologue)}; then " if assembly.prologue else ""
    again = "in the order that it learns" if schedule.ordering else "again and again"
    yield f"schedule {schedule.name}: {first}{', '.join(schedule.order)}, {again}"
    if schedule.learn_delay:
        yield f"learning costs {describe(schedule.learn_delay)} more for each transition"
    if schedule.period:
        yield f"a cycle every {describe(schedule.period)}; after a late one: {schedule.overrun.value}"


def _warnings(scenario: Scenario, assembly: Assembly) -> Iterator[str]:
    schedule = assembly.schedule
    synchronous = any(device.spec.synchronous for device in assembly.devices.values())
    slowed = schedule.learn_delay and schedule.learn.inline
    real = scenario.model.run.clock == "real"
    if real and assembly.never_sleeps and not slowed and not synchronous:
        yield "note: nothing paces this loop, so it will keep a core busy; give schedule.period a value."
    if synchronous and not (scenario.model.run.episode_steps or scenario.model.run.episode_time):
        yield "note: nothing bounds an episode of this synchronous world; give run.episode_steps a value."
    if real and assembly.never_sleeps and assembly.realtime.priority:
        yield "note: this loop never sleeps, so it gets no realtime.priority; give schedule.period a value."
    if (pause := assembly.pause) > schedule.observe_timeout:
        yield (
            f"note: nothing new comes for {describe(pause)} at a time, and observe waits for "
            f"{describe(schedule.observe_timeout)} at most, then takes what it has once more; "
            "give schedule.observe_timeout more."
        )
    costs = [component.value for component in assembly.costs]
    if costs and real:
        yield f"note: costs ({', '.join(costs)}) are charged under the virtual clock only."
