"""An agent that answers events in a pipe while long jobs of learning wait for it."""

from __future__ import annotations

import multiprocessing
import os
import random
import time
import zlib
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from statistics import mean, median

import numpy as np
from _components import STAMP, AnswerTask, PipeDevice

from rtagent import Agent, Limits, Plan, Schedule, Stimulus, Transition, run
from rtagent.experience import FeatureVector
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import Greedy
from rtagent.reaction import Reaction
from rtagent.realtime import Realtime
from rtagent.runtime import Habits
from rtagent.units import ms, second, us

SHORTEST, LONGEST = 0.001, 0.003
"""The interval between two events, in seconds: 500 a second in the mean."""

JOB, PIECE = 500 * ms, 35 * us
WARM_UP = 20
"""So many first events of an episode are left out."""

NOWHERE = FeatureVector(np.zeros(0, dtype=np.intp))


def write_events(pipe: Connection) -> None:
    """Write the time into the pipe at random intervals, until nobody reads it."""
    intervals = random.Random(0)  # noqa: S311  # nothing secret is drawn
    while True:
        time.sleep(intervals.uniform(SHORTEST, LONGEST))
        try:
            os.write(pipe.fileno(), STAMP.pack(time.monotonic_ns()))
        except BrokenPipeError:
            return


@contextmanager
def events() -> Iterator[int]:
    """Have another process write events into a pipe; give the end to read them from."""
    spawn = multiprocessing.get_context("spawn")
    pipe, other_end = spawn.Pipe(duplex=False)
    writer = spawn.Process(target=write_events, args=(other_end,))
    writer.start()
    other_end.close()
    try:
        yield pipe.fileno()
    finally:
        pipe.close()
        writer.join()


class EventDevice(PipeDevice):
    """Every event is a stimulus, also one that a newer has overtaken; those of before it was opened are gone."""

    spec = replace(PipeDevice.spec, rate=1 / mean((SHORTEST, LONGEST)))

    def __init__(self, pipe: int, sink: int) -> None:
        super().__init__(pipe, sink)
        self._stamps: deque[int] = deque()

    async def open(self) -> None:
        os.set_blocking(self._pipe, False)
        try:
            while os.read(self._pipe, 1 << 16):
                pass
        except BlockingIOError:
            os.set_blocking(self._pipe, True)
        await super().open()

    def stimuli(self, after: int, until: int) -> Sequence[Stimulus]:
        found = []
        while self._stamps and self._stamps[0] <= until:
            found.append(Stimulus(self._stamps.popleft(), "event"))
        return found

    def _receive(self) -> None:
        super()._receive()
        if self._newest is not None:
            self._stamps.append(self._newest.world_time)


class Work:
    """Pieces of real work without the GIL, each of some 35 µs; `done` counts them."""

    def __init__(self) -> None:
        self._bytes = bytes(1 << 16)
        self._bytes = bytes(int(len(self._bytes) * PIECE / self.duration()))
        self.pieces = round(JOB / self.duration())
        self.done = 0

    def piece(self) -> None:
        """Do a piece."""
        zlib.crc32(self._bytes)
        self.done += 1

    def duration(self) -> float:
        """Return how long (ns) a piece takes when nothing else is done, by the median of some."""
        return median(self._timed() for _ in range(201))

    def _timed(self) -> int:
        start = time.monotonic_ns()
        zlib.crc32(self._bytes)
        return time.monotonic_ns() - start


class BusySarsa(Sarsa):
    """Sarsa for which a transition of no state is a job of 500 ms, until the episode has ended.

    The job leaves the action values alone where it is `apart`, as what a Horde learns beside control does.
    """

    def __init__(self, work: Work, apart: bool, *, size: int, actions: int) -> None:
        super().__init__(size=size, actions=actions)
        self._work, self._apart = work, apart
        self.jobs, self.over = 0, False

    def update(self, transition: Transition) -> float:
        if transition.features is not NOWHERE:
            return super().update(transition)
        for _ in self.updating(transition):
            pass
        return 0.0

    def updating(self, transition: Transition) -> Generator[bool | None, None, float]:
        if transition.features is not NOWHERE:
            return (yield from super().updating(transition))
        yield self._apart
        for _ in range(self._work.pieces):
            if self.over:
                return 0.0
            self._work.piece()
            yield self._apart
        self.jobs += 1
        return 0.0

    def episode_ended(self, episode: object) -> None:
        """Leave off: what is left is not measured any more."""
        self.over = True


def job() -> Transition:
    """Return a transition that takes 500 ms to learn."""
    return Transition(NOWHERE, 0, 1.0, 0.0, NOWHERE, 0, 0, False, False)


class Log:
    """Keeps objects of each reaction, as a user's instrument may: garbage collection has ever more to look at."""

    def __init__(self, objects: int) -> None:
        self._objects = objects
        self.kept: list[list[list[int]]] = []

    def reacted(self, reaction: Reaction) -> None:
        """Keep as many objects."""
        self.kept.append([[number] for number in range(self._objects)])


@dataclass(frozen=True)
class Variant:
    """A way of running the agent.

    `apart`: learning leaves the action values alone; `logged`: so many objects are kept of each reaction.
    """

    name: str
    schedule: Schedule
    realtime: Realtime = field(default_factory=Realtime)
    apart: bool = True
    logged: int = 0


@dataclass
class Block:
    """Some seconds of one agent: its reaction times (ns), and what learning had of the processor.

    `share` is the part of the time by the run's own account, `worked` by the work that was done.
    """

    reactions: list[int]
    share: float
    worked: float


def agent_with_jobs(work: Work, task: AnswerTask, jobs: int, apart: bool) -> tuple[Agent, BusySarsa]:
    """Return an agent for whose learning so many jobs wait, and its learner."""
    features = Tabular(state=task.state)
    learner = BusySarsa(work, apart, size=features.size, actions=len(task.actions))
    agent = Agent(features, learner, Greedy(), np.random.default_rng(0))
    agent.queue.extend(job() for _ in range(jobs))
    return agent, learner


async def block(ends: tuple[int, int], work: Work, variant: Variant, seconds: float, habits: Habits) -> Block:
    """Run an agent for some seconds, with always a job waiting if it learns; `ends` are its pipe and its sink."""
    task, learns = AnswerTask(), variant.schedule.learns
    jobs = int(seconds * second / JOB) + 2 if learns else 0
    agent, learner = agent_with_jobs(work, task, jobs, variant.apart)
    instruments = [learner, Log(variant.logged)] if variant.logged else [learner]
    plan = Plan(limits=Limits(episode_time=int(seconds * second)))
    before, piece = work.done, work.duration()
    devices = {"pipe": EventDevice(*ends)}
    result = await run(devices, task, agent, variant.schedule, plan, instruments=instruments, habits=habits)
    if learns and learner.jobs >= jobs - 1:
        raise RuntimeError("the jobs ran out before the episode ended: measure again on a quieter machine.")
    return Block(
        result.reaction_times[WARM_UP:],
        result.recorder.learning_time / result.recorder.elapsed,
        (work.done - before) * piece / result.episodes[0].duration,
    )
