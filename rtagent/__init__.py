"""rtagent: an asyncio real-time agent runtime.

The names below are imported when they are first used, so that importing rtagent costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rtagent import clock
    from rtagent.agent import Agent
    from rtagent.costs import Cost
    from rtagent.experience import Observation, Outcome, Sample, Stimulus, Transition
    from rtagent.latch import Latch
    from rtagent.lifecycle import Plan, run
    from rtagent.plugins import register
    from rtagent.protection import Watchdog
    from rtagent.result import Result, RunError
    from rtagent.runtime import Limits
    from rtagent.schedule import Component, Schedule
    from rtagent.specs import DeviceSpec, Spec
    from rtagent.supervision import Supervision
    from rtagent.telemetry.subscribe import subscribe
    from rtagent.units import ms, second, us

__version__ = "0.1.0"

_HOMES = {
    "Agent": "agent",
    "Component": "schedule",
    "Cost": "costs",
    "DeviceSpec": "specs",
    "Latch": "latch",
    "Limits": "runtime",
    "Observation": "experience",
    "Outcome": "experience",
    "Plan": "lifecycle",
    "Result": "result",
    "RunError": "result",
    "Sample": "experience",
    "Schedule": "schedule",
    "Spec": "specs",
    "Stimulus": "experience",
    "Supervision": "supervision",
    "Transition": "experience",
    "Watchdog": "protection",
    "ms": "units",
    "register": "plugins",
    "run": "lifecycle",
    "second": "units",
    "subscribe": "telemetry.subscribe",
    "us": "units",
}

__all__ = [
    "Agent",
    "Component",
    "Cost",
    "DeviceSpec",
    "Latch",
    "Limits",
    "Observation",
    "Outcome",
    "Plan",
    "Result",
    "RunError",
    "Sample",
    "Schedule",
    "Spec",
    "Stimulus",
    "Supervision",
    "Transition",
    "Watchdog",
    "clock",
    "ms",
    "register",
    "run",
    "second",
    "subscribe",
    "us",
]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "clock":
        return import_module("rtagent.clock")
    if name not in _HOMES:
        raise AttributeError(f"module 'rtagent' has no attribute {name!r}")
    return getattr(import_module(f"rtagent.{_HOMES[name]}"), name)
