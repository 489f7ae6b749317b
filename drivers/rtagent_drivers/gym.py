"""Any Gymnasium environment as a world that does not wait: it goes on at its own step under the last action."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.random import Generator

from rtagent.errors import DeviceError, SpecError
from rtagent.experience import Command, Stimulus, Values
from rtagent.saving import Saved
from rtagent.units import Duration, describe, second
from rtagent_drivers.fake import FakeDevice, Faults, Sampling
from rtagent_drivers.gym_environment import Environment, Frame, Step, make, own_step

KEPT = 1000
"""So many steps are remembered at least, for samples that come late."""


class GymnasiumWorld:
    """An environment as a function of time: at the end of each `step` (ns) it makes one, under the last action.

    An action counts for the whole of the step in which it comes. Before the first of an episode that is `idle`.
    What was so is kept for `reach` (ns) at least, for samples that come late.
    """

    def __init__(
        self, environment: Environment, step: int, idle: int = 0, reach: int = 0, notes: Sequence[str] = ()
    ) -> None:
        self._environment, self._step, self._idle = environment, step, idle
        self._kept = KEPT + reach // step
        self.spec = environment.spec(synchronous=False)
        self.notes = notes

    def prepare(self, rng: Generator) -> None:
        """Reset the environment, which may take long."""
        self._first = self._environment.reset(rng)

    def begin(self, now: int, rng: Generator) -> None:
        """Begin with what the reset gave."""
        self._frames = [Frame(now, self._first)]
        self._action = self._idle
        self._actions: list[int] = []

    def values(self, time: int) -> Values:
        """Return the newest frame at `time` (ns); raise `DeviceError` where that is forgotten."""
        self._go_on(time)
        place = self._following(time)
        if not place:
            raise DeviceError(f"what was so at that time is forgotten: it was more than {self._kept} steps ago.")
        return self._frames[place - 1].values()

    def command(self, now: int, command: Command) -> Command:
        """Take the action that is in force from now on."""
        self._go_on(now)
        self._action = int(command["action"])
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: no environment says what calls for a reaction."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return the end of the step that goes on at `now`, or None after the last."""
        self._go_on(now)
        place = max(self._following(now), 1)
        if place < len(self._frames):
            return self._frames[place].time
        newest = self._frames[-1]
        return None if newest.over else newest.time + self._step

    def make_safe(self, now: int) -> None:
        """Do nothing: nothing of it moves outside this process."""

    def save(self) -> Saved:
        """Return the actions of the episode: its steps follow from them, and from its reset."""
        return save_steps(self._actions, self._frames[-1]) | {"action": self._action}

    def restore(self, saved: Saved) -> None:
        """Make the steps again; raise `SpecError` where that leads somewhere else."""
        for action in saved["actions"].tolist():
            self._action = action
            self._go_on(self._frames[-1].time + self._step)
        self._action = saved["action"]
        check_repeated(saved, self._frames[-1])

    def _following(self, time: int) -> int:
        """Return the place of the first frame after `time`."""
        if self._frames[-1].time <= time:
            return len(self._frames)
        return bisect_right(self._frames, time, key=lambda frame: frame.time)

    def _go_on(self, time: int) -> None:
        newest = self._frames[-1]
        while not newest.over and newest.time + self._step <= time:
            self._actions.append(self._action)
            newest = self._environment.step(newest, self._action, self._step)
            self._frames.append(newest)
            if len(self._frames) > 2 * self._kept:
                del self._frames[: self._kept]


class SynchronousGymnasiumWorld:
    """An environment that waits: each command is a step of it, and nothing else is."""

    def __init__(self, environment: Environment, notes: Sequence[str] = ()) -> None:
        self._environment = environment
        self.spec = environment.spec(synchronous=True)
        self.notes = notes

    def prepare(self, rng: Generator) -> None:
        """Reset the environment, which may take long."""
        self._first = self._environment.reset(rng)

    def begin(self, now: int, rng: Generator) -> None:
        """Begin with what the reset gave."""
        self._newest = Frame(now, self._first)
        self._actions: list[int] = []

    def values(self, time: int) -> Values:
        """Return what the last step gave."""
        return self._newest.values()

    def command(self, now: int, command: Command) -> Command:
        """Make a step, unless the environment has ended."""
        if not self._newest.over:
            self._actions.append(int(command["action"]))
            self._newest = self._environment.step(self._newest, self._actions[-1], 0)
        return command

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        """Return nothing: nothing happens by itself."""
        return ()

    def next_change(self, now: int) -> int | None:
        """Return None: nothing happens by itself."""
        return None

    def make_safe(self, now: int) -> None:
        """Do nothing: it does not move by itself."""

    def save(self) -> Saved:
        """Return the actions of the episode: its steps follow from them, and from its reset."""
        return save_steps(self._actions, self._newest)

    def restore(self, saved: Saved) -> None:
        """Make the steps again; raise `SpecError` where that leads somewhere else."""
        for action in saved["actions"].tolist():
            self.command(self._newest.time, {"action": action})
        check_repeated(saved, self._newest)


def save_steps(actions: Sequence[int], newest: Frame) -> Saved:
    """Return the actions of an episode, and where they have led."""
    return {"actions": np.array(actions, np.int64), "led_to": newest.values()}


def check_repeated(saved: Saved, newest: Frame) -> None:
    """Raise `SpecError` unless the actions that were saved have led again to where they did."""
    if newest.values() != saved["led_to"]:
        raise SpecError(
            "the environment does not repeat itself: from the same reset the same actions have led somewhere else, "
            "so that an episode cannot be gone on with; begin the run anew."
        )


def gymnasium_world(
    *,
    environment: str,
    arguments: dict[str, Any] | None = None,
    step: Duration = 0,
    synchronous: bool = False,
    ranges: dict[str, tuple[float, float]] | None = None,
    actions: tuple[tuple[float, ...], ...] = (),
    idle: int = 0,
    sampling: Sampling | None = None,
    faults: Faults | None = None,
) -> FakeDevice:
    """A Gymnasium environment that goes on by itself at its own time step, or step by step if synchronous."""
    if step < 0:
        raise SpecError("step is negative: give a time, or leave it out for the environment's own.")
    made = make(environment, arguments or {})
    wrapped = Environment(made.environment, ranges or {}, actions)
    if not 0 <= idle < wrapped.actions:
        raise SpecError(f"idle is {idle}: give one of the {wrapped.actions} actions, counted from 0.")
    if synchronous:
        if sampling is not None:
            raise SpecError("a synchronous environment changes with commands only: leave out sampling.")
        return FakeDevice(SynchronousGymnasiumWorld(wrapped, made.warnings), None, faults)
    own = Step(step, "step") if step else own_step(made.environment)
    sampling = sampling or Sampling(rate=second / own.length)
    notes = [f"a step takes {describe(own.length)} (its {own.source})", *made.warnings]
    world = GymnasiumWorld(wrapped, own.length, idle, _reach(sampling, faults or Faults()), notes)
    return FakeDevice(world, sampling, faults)


def _reach(sampling: Sampling, faults: Faults) -> int:
    """Return how old the newest sample may be, in ns, if none is lost."""
    period = round(second / sampling.rate) if sampling.rate else 0
    return period + sampling.delay + sampling.jitter + faults.lateness
