"""Scenarios for hardware: each runs on its fakes, on the wire and in the process, and comes to the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from rtagent import Result, clock
from rtagent.scenario import assemble, load

HERE = Path(__file__).parent.parent / "scenarios"
SCENARIOS = ["bento_stopping.toml", "mini_bento_stopping.toml"]
QUICK = [
    "run.episodes=8",
    'devices.timer.after=["0.1s", "0.3s"]',
    "schedule.learn_delay=5ms",
    'devices.arm.joints.wrist_rotation.start="0deg"',
    # what is tested is not how quickly a shared machine lets a process run
    'watchdog.timeout="2s"',
    'devices.arm.silence="2s"',
    'devices.arm.bus_watchdog="2s"',
    'devices.arm.supervision.timeout="5s"',
]
NORMAL, EMERGENCY = (0.0,), (1.0,)


def run_on(fake: str, scenario: str, *settings: str, clock_name: clock.ClockName = "real") -> Result:
    assembly = assemble(load(HERE / scenario, [*QUICK, f"run.fake={fake}", *settings]))
    return clock.run(assembly.run(), clock_name)


def policy(result: Result) -> tuple[int, int]:
    """What the agent, as it ended, does in Normal and in Emergency."""
    agent = result.agents[-1]
    values = [agent.learner.action_values(agent.features.encode(state)) for state in (NORMAL, EMERGENCY)]
    return int(values[0].argmax()), int(values[1].argmax())


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_stopping_task_is_learned_under_the_virtual_clock(scenario: str) -> None:
    result = run_on("process", scenario, clock_name="virtual")
    assert not result.not_safe
    assert not result.faults
    assert policy(result) == (0, 1)
    assert result.reaction_time.count == 8


@pytest.mark.slow
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_wire_and_process_come_to_the_same(scenario: str) -> None:
    wire, process = (run_on(fake, scenario) for fake in ("wire", "process"))
    assert (wire.not_safe, process.not_safe) == ([], [])
    assert ([fault for fault in wire.faults if fault.fatal], process.faults) == ([], [])
    assert policy(wire) == policy(process) == (0, 1)
    assert wire.reaction_time.count == process.reaction_time.count == 8
