"""What telemetry tells of a run as a whole."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
from typing import Any

from rtagent.device import Pressable
from rtagent.learning import Horde
from rtagent.learning.cumulants import Signal as SignalCumulant
from rtagent.learning.cumulants import Within
from rtagent.learning.demons import Demon
from rtagent.scenario import Assembly, Scenario
from rtagent.specs import Spec
from rtagent.telemetry.records import DemonAbout, DeviceSignals, Signal

VERSIONS = ("rtagent", "numpy", "numba", "eclipse-zenoh", "mcap", "msgspec")


def about_run(scenario: Scenario, assembly: Assembly) -> dict[str, Any]:
    """Return what is told of a run before it begins, but for its place and its times."""
    specs = {name: assembly.supervision[name].spec_of(device) for name, device in assembly.devices.items()}
    devices = {
        name: DeviceSignals(
            {sensor: _signal(each) for sensor, each in spec.sensors.items()},
            {actuator: _signal(each) for actuator, each in spec.actuators.items()},
            _finite(spec.rate),
        )
        for name, spec in specs.items()
    }
    return {
        "clock": scenario.model.run.clock,
        "seed": scenario.model.run.seed,
        "scenario": scenario.resolved(),
        "machine": machine(),
        "versions": versions(),
        "devices": devices,
        "state": list(assembly.task.state),
        "actions": list(assembly.task.actions),
        "buttons": [name for name, device in assembly.devices.items() if isinstance(device, Pressable)],
    }


def machine() -> dict[str, Any]:
    """Return what is known of this machine."""
    return {
        "system": platform.platform(),
        "architecture": platform.machine(),
        "processors": os.cpu_count(),
        "python": platform.python_version(),
    }


def versions() -> dict[str, str]:
    """Return the versions of what a result depends on."""
    found = {}
    for name in VERSIONS:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = ""
    return found


def about_demons(horde: Horde, places: list[int], state: list[str]) -> list[DemonAbout]:
    """Return what the demons at these places predict."""
    return [_about(horde.demons[place], state) for place in places]


def _about(demon: Demon, state: list[str]) -> DemonAbout:
    cumulant, gamma = demon.cumulant, demon.continuation.gamma
    signal = state[cumulant.place] if isinstance(cumulant, SignalCumulant | Within) else ""
    low, high = (cumulant.low, cumulant.high) if isinstance(cumulant, Within) else (math.inf, math.inf)
    return DemonAbout(
        demon.name,
        signal,
        _finite(low),
        _finite(high),
        float(gamma) if isinstance(gamma, int | float) else None,
        demon.continuation.per,
        demon.normalised,
    )


def _signal(spec: Spec) -> Signal:
    return Signal(spec.dtype, list(spec.shape), spec.unit, _finite(spec.low), _finite(spec.high))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
