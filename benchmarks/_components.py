"""Components for the benchmarks: some that do nothing, and an agent that answers events in a pipe."""

from __future__ import annotations

import asyncio
import itertools
import os
import struct
import time
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.random import Generator

from rtagent import DeviceSpec, Observation, Outcome, Sample, Spec, Stimulus
from rtagent.experience import Command, FeatureVector, FloatArray, State

STAMP = struct.Struct("q")
"""An event in the pipe: the time, in ns."""


# Components that do nothing


class EmptyDevice:
    """Reads at once, and does nothing when told to act."""

    spec = DeviceSpec(sensors={"signal": Spec()}, actuators={"motion": Spec()})

    def __init__(self) -> None:
        self._sequence = itertools.count()
        self._values = {"signal": 0.0}

    async def open(self) -> None: ...

    async def read(self, newer_than: int) -> Sample:
        now = time.monotonic_ns()
        return Sample(self._values, now, now, next(self._sequence))

    async def act(self, command: Command) -> Command:
        return command

    async def make_safe(self) -> None: ...

    async def close(self) -> None: ...


class EmptyTask:
    """Sees one state, whatever happens."""

    state: Mapping[str, Spec] = {"signal": Spec()}
    actions: Sequence[str] = ("only",)

    def __init__(self) -> None:
        self._outcome, self._commands = Outcome((0.0,)), {"device": {"motion": 0.0}}

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None: ...

    def begin(self) -> None: ...

    def interpret(self, observation: object) -> Outcome:
        return self._outcome

    def commands(self, action: int) -> Mapping[str, Command]:
        return self._commands

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return False


class EmptyCoder:
    """Gives one vector, whatever the state."""

    size = active = 1

    def __init__(self) -> None:
        self._vector = FeatureVector(np.zeros(1, dtype=np.intp))

    def encode(self, state: State) -> FeatureVector:
        return self._vector


class EmptyLearner:
    """Learns nothing."""

    needs_next_action = True

    def __init__(self) -> None:
        self._values = np.zeros(1)

    def action_values(self, features: FeatureVector) -> FloatArray:
        return self._values

    def update(self, transition: object) -> float:
        return 0.0


class EmptyPolicy:
    """Chooses the only action."""

    def choose(self, action_values: FloatArray, rng: Generator) -> tuple[int, float]:
        return 0, 1.0

    def probabilities(self, action_values: FloatArray) -> FloatArray:
        return np.ones(1)


class OneHook:
    """An instrument with one hook, which does nothing."""

    def acted(self, action: int, sent: Mapping[str, Command], start: int, end: int) -> None: ...


# An agent that answers events in a pipe


class PipeDevice:
    """Each event is a sample; the world's time is the one that the writer stamped."""

    spec = DeviceSpec(sensors={"parity": Spec.discrete(2)}, actuators={"answer": Spec.discrete(2)})

    def __init__(self, pipe: int, sink: int) -> None:
        self._pipe, self._sink = pipe, sink
        self._newest: Sample | None = None
        self._arrived: asyncio.Future[None] | None = None
        self.reactions: list[int] = []

    async def open(self) -> None:
        asyncio.get_running_loop().add_reader(self._pipe, self._receive)

    async def read(self, newer_than: int) -> Sample:
        while self._newest is None or self._newest.sequence <= newer_than:
            self._arrived = asyncio.get_running_loop().create_future()
            await self._arrived
        return self._newest

    async def act(self, command: Command) -> Command:
        os.write(self._sink, STAMP.pack(int(command["answer"])))
        if self._newest is not None:
            self.reactions.append(time.monotonic_ns() - self._newest.world_time)
        return command

    async def make_safe(self) -> None: ...

    async def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self._pipe)

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        return (Stimulus(until, "event"),)

    def _receive(self) -> None:
        (stamp,) = STAMP.unpack(os.read(self._pipe, STAMP.size))
        sequence = 0 if self._newest is None else self._newest.sequence + 1
        self._newest = Sample({"parity": sequence % 2}, stamp, time.monotonic_ns(), sequence)
        if self._arrived is not None and not self._arrived.done():
            self._arrived.set_result(None)


class AnswerTask:
    """One of two answers to each event; any earns 1, so that the greedy policy soon has a preference."""

    state: Mapping[str, Spec] = {"parity": Spec.discrete(2)}
    actions: Sequence[str] = ("even", "odd")

    def __init__(self) -> None:
        self._commands = tuple({"pipe": {"answer": action}} for action in range(2))

    def bind(self, devices: Mapping[str, DeviceSpec]) -> None: ...

    def begin(self) -> None: ...

    def interpret(self, observation: Observation) -> Outcome:
        return Outcome((float(observation.samples["pipe"].values["parity"]),), 1.0)

    def commands(self, action: int) -> Mapping[str, Command]:
        return self._commands[action]

    def answers(self, action: int, stimulus: Stimulus) -> bool:
        return True
