"""Idling in virtual time: after two cycles that charged nothing and changed nothing, the next event is awaited.

Two, because the first cycle of an episode may have nothing to learn yet.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rtagent.clock import Clock
from rtagent.errors import RunStuckError
from rtagent.saving import Saved, restore_fields, save_fields
from rtagent.supervision import SupervisedDevice

IDLE_CYCLES = 1000
"""So many cycles at one virtual instant, and the run is waiting for something, whatever it does."""


class Idling:
    """Lets virtual time pass between cycles that would take none of it."""

    def __init__(self, devices: Sequence[SupervisedDevice], clock: Clock, episode_time: int) -> None:
        self._devices = devices
        self._synchronous = any(device.device.spec.synchronous for device in devices)
        self._surprising = any(device.surprising for device in devices)
        self._clock, self._episode_time = clock, episode_time
        self.begin(0)
        self.learning: Callable[[int], int | None] = lambda now: None

    def begin(self, now: int) -> None:
        """Begin an episode at `now` (ns)."""
        self._instant = now
        self._ends = now + self._episode_time if self._episode_time else None
        self._idle_cycles = 0

    async def cycle_ended(self, settled: bool) -> None:
        """Wait for the next event if cycles take no time and this one was `settled`: the agent does the same.

        Raises `RunStuckError` after a thousand cycles at an instant that no event will follow.
        """
        now = self._clock.now()
        if now != self._instant or self._synchronous:
            self._instant, self._idle_cycles = now, 0
            return
        self._idle_cycles += 1
        jumps = settled and self._idle_cycles > 1 and not self._surprising
        if jumps or self._idle_cycles >= IDLE_CYCLES:
            await self._wait_for_event(now)

    async def _wait_for_event(self, now: int) -> None:
        event = self._next_event(now)
        if event is not None:
            await self._clock.sleep_until(event)
            self._instant, self._idle_cycles = self._clock.now(), 0
        elif self._idle_cycles >= IDLE_CYCLES:
            raise RunStuckError(
                f"{IDLE_CYCLES} cycles took no virtual time and nothing is going to happen: give a component "
                "a cost, schedule.period a value, or a device a rate."
            )

    def save(self) -> Saved:
        """Return how long it has been idle, and when the episode ends."""
        return save_fields(self, ("_instant", "_ends", "_idle_cycles"))

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_fields(self, ("_instant", "_ends", "_idle_cycles"), saved)

    def _next_event(self, now: int) -> int | None:
        events = [device.next_event(now) for device in self._devices] + [self._ends, self.learning(now)]
        return min((event for event in events if event is not None and event > now), default=None)
