"""The safe state of an arm: written, read back, and tried again until every servo has it or time is up."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence

from rtagent.errors import DeviceError
from rtagent.units import describe, ms, second
from rtagent_drivers.dynamixel.bus import Bus
from rtagent_drivers.dynamixel.exchange import Question
from rtagent_drivers.dynamixel.orders import Order, questions, reads_in_groups, switch, sync_writes, unwatch
from rtagent_drivers.dynamixel.packets import Span
from rtagent_drivers.dynamixel.servo import Servo
from rtagent_drivers.dynamixel.settings import Stop

STALE = 100 * ms
"""A reading older than this does not say where a joint is."""

PAUSE = 2 * ms
"""Between one attempt and the next."""


async def secure(bus: Bus, servos: Sequence[Servo], stop: Stop, within: int, now: Callable[[], int]) -> None:
    """Hold or release every servo within a time (ns); raise `DeviceError` that names those that are not safe."""
    ends, left, alone = now() + within, list(servos), False
    while left and now() < ends:
        if stop == "hold":
            await _look(bus, left, now, alone)
        left = await _attempt(bus, left, stop, now, alone)
        alone = True  # behind one that is silent the others of a group cannot be heard
        if left:
            await asyncio.sleep(PAUSE / second)
    if left:
        names = ", ".join(f"{servo.axis.name} (id {servo.id})" for servo in left)
        raise DeviceError(
            f"not safe after {describe(within)}: {names}. Switch the servos' power off, and keep clear of the arm."
        )


async def _look(bus: Bus, servos: Sequence[Servo], now: Callable[[], int], alone: bool) -> None:
    """Read where joints are that are on, and were not read lately."""
    stale = [servo for servo in servos if servo.on and now() - servo.read_at > STALE]
    if not stale:
        return
    statuses = await bus.emergency([], _questions(bus, {servo: servo.span for servo in stale}, alone))
    for servo in stale:
        if servo.id in statuses and len(statuses[servo.id].parameters) == servo.span.length:
            servo.hear(statuses[servo.id].parameters, now())


async def _attempt(
    bus: Bus, servos: Sequence[Servo], stop: Stop, now: Callable[[], int], alone: bool
) -> list[Servo]:
    """Write the safe state of servos, and return those that do not have it."""
    orders = {servo: safe_order(servo, stop, now()) for servo in servos}
    spans = {servo: Span(servo.id, order.address, len(order.data)) for servo, order in orders.items()}
    awake = {servo.id: order for servo in servos if (order := unwatch(servo.model)) is not None}
    safe = {servo.id: order for servo, order in orders.items()}
    writes = [*sync_writes(bus.codec, awake), *sync_writes(bus.codec, safe)]
    statuses = await bus.emergency(writes, _questions(bus, spans, alone))
    left = []
    for servo, order in orders.items():
        if servo.id in statuses and statuses[servo.id].parameters == order.data:
            servo.on = servo.on and order != switch(servo.model, on=False)
            servo.limits.reset()
        else:
            left.append(servo)
    return left


def safe_order(servo: Servo, stop: Stop, now: int) -> Order:
    """Return what makes a servo safe: reading the same bytes back proves it.

    A servo that is commanded by torque has no place to hold: it is released.
    """
    holds = stop == "hold" and servo.on and servo.reading is not None and servo.axis.joint.mode != "torque"
    return servo.stay(now) if holds else switch(servo.model, on=False)


def _questions(bus: Bus, spans: Mapping[Servo, Span], alone: bool) -> list[Question]:
    singly = [span for servo, span in spans.items() if alone or not reads_in_groups(servo.model)]
    return questions(bus.codec, [span for span in spans.values() if span not in singly], singly)
