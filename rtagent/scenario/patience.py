"""Whether what guards the hardware is patient enough for the learning that a scenario declares."""

from __future__ import annotations

from math import isfinite

from rtagent.device import Device, Impatient
from rtagent.errors import SpecError
from rtagent.learn import Where
from rtagent.schedule import Schedule
from rtagent.units import describe, second
from rtagent.watchdog.process import BEATS

CURE = "learn in slices (learn.slice), or on a thread (learn.where)"


def check_watchdog(timeout: int, schedule: Schedule) -> None:
    """Raise `SpecError` where learning would keep the event loop from its heartbeats for `timeout` (ns)."""
    busy, key = longest_inline(schedule)
    beat = timeout // BEATS
    if busy and timeout <= busy + beat:
        raise SpecError(
            f"a heartbeat is due every {describe(beat)}, and learning keeps the event loop from it for "
            f"{describe(busy)} ({key}): {describe(beat)} + {describe(busy)} = {describe(beat + busy)} without one, "
            f"but the watchdog takes {describe(timeout)} for a stall: give it more than "
            f"{describe(busy * BEATS / (BEATS - 1))}, or {CURE}."
        )


def check_tolerance(device: Device, schedule: Schedule) -> None:
    """Raise `SpecError` where learning would keep the event loop from hardware that stops by itself."""
    busy, key = longest_inline(schedule)
    tolerates = device.tolerates if isinstance(device, Impatient) else 0
    rate = device.spec.rate
    period = round(second / rate) if rate and isfinite(rate) else 0
    if tolerates and busy and tolerates <= busy + period:
        raise SpecError(
            f"it is spoken to every {describe(period)}, and learning keeps the event loop from it for "
            f"{describe(busy)} ({key}): {describe(period)} + {describe(busy)} = {describe(period + busy)} "
            f"of silence, but its hardware stops by itself after {describe(tolerates)}: "
            f"have it wait for longer, or {CURE}."
        )


def longest_inline(schedule: Schedule) -> tuple[int, str]:
    """Return how long (ns) learning keeps the event loop busy at a time, and the key that says so."""
    if not schedule.learns or schedule.learn.where is Where.THREAD:
        return 0, ""
    if schedule.learn.slice:
        return schedule.learn.slice, "learn.slice"
    return schedule.learn_delay, "schedule.learn_delay"
