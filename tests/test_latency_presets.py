"""Every preset keeps its promise to the nanosecond, and nothing in its cycle is new.

What each allocates is kept in allocations.json, of one version of Python: `python tests/test_latency_presets.py`
counts it anew, where a change of it is meant.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest
from parts import SCENARIOS

from rtagent import ms, us
from rtagent.latencies import Subject
from rtagent.latencies.allocations import allocations
from rtagent.latencies.fixture import Latency
from rtagent.schedule import FIXED

STOPPING = str(SCENARIOS / "stopping.toml")
KEPT = Path(__file__).with_name("allocations.json")
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
ROOM = 1.25
"""Another version of Python allocates otherwise, but hardly so much more."""

COSTS = 2 * (1 * ms + 2 * ms)
"""Of act and choose, in the cycle in which a stimulus comes too late to be observed, and in the one that reacts."""
LEARNING = {
    "standard": 2 * 20 * ms,
    "reactive": 20 * ms,
    "deferred": 20 * ms,
    "interruptible": 100 * us,
    "background": 0,
}
"""How long learning that takes 20 ms may delay a reaction: twice, once, a slice, not at all."""


def keys(preset: str) -> tuple[str, ...]:
    return ("run.clock=virtual", "run.episodes=4", f"schedule.preset={preset}", "schedule.learn_delay=20ms")


def short(preset: str) -> tuple[str, ...]:
    """Return the keys with which few cycles pass, and few slices in each."""
    return (*keys(preset), "schedule.learn_delay=100us", "devices.joint.onset=['20ms', '30ms']")


@pytest.mark.parametrize("preset", FIXED)
def test_a_preset_keeps_its_promise(preset: str, rtagent_latency: Latency) -> None:
    measured = rtagent_latency.run(STOPPING, *keys(preset), "costs.act=1ms", "costs.choose=2ms")
    measured.assert_at_most(LEARNING[preset] + COSTS, least=4)


@pytest.mark.parametrize("preset", FIXED)
def test_a_slowdown_of_a_component_breaks_it(preset: str, rtagent_latency: Latency) -> None:
    slow = ("costs.act=1ms", f"costs.choose={2 * ms + LEARNING[preset] + COSTS}ns")
    measured = rtagent_latency.run(STOPPING, *keys(preset), *slow)
    with pytest.raises(AssertionError, match="The component that took longest is choose"):
        measured.assert_at_most(LEARNING[preset] + COSTS)


@pytest.mark.slow
@pytest.mark.parametrize("preset", FIXED)
def test_no_function_allocates_more_than_it_did(preset: str, rtagent_latency: Latency) -> None:
    kept = json.loads(KEPT.read_text())
    counts = rtagent_latency.allocations(STOPPING, *short(preset))
    if kept["python"] == PYTHON:
        counts.assert_no_more_than(kept[preset])
    else:
        counts.assert_at_most(ROOM * sum(kept[preset].values()))


@pytest.mark.slow
@pytest.mark.parametrize("preset", FIXED)
def test_no_system_call_is_made_but_those_known(preset: str, rtagent_latency: Latency) -> None:
    known = {"getpid": 1.0} if preset == "background" else {}  # asyncio asks when it makes a future
    rtagent_latency.system_calls(STOPPING, *short(preset), episodes=2).assert_no_more_than(known)


def keep() -> None:
    """Count anew."""
    found: dict[str, Any] = {"python": PYTHON}
    for preset in FIXED:
        found[preset] = allocations(Subject.scenario(STOPPING, *short(preset))).per_cycle
    KEPT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    keep()
