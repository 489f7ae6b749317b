"""Measures what the runtime adds: to an empty cycle, and to the reaction to an event of another process."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import random
import sys
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from statistics import median

import numpy as np
from _components import (
    STAMP,
    AnswerTask,
    EmptyCoder,
    EmptyDevice,
    EmptyLearner,
    EmptyPolicy,
    EmptyTask,
    OneHook,
    PipeDevice,
)
from _harness import Row, main

from rtagent import Agent, Limits, Plan, Schedule, Transition, clock, run
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import Greedy

CYCLE_ROUNDS, CYCLES = 31, 2_000
REACTION_ROUNDS, EVENTS, WARM_UP = 10, 250, 5
SHORTEST, LONGEST = 0.002, 0.006
"""The interval between two events, in seconds."""

REACTIVE = Schedule.preset("reactive")


# One cycle


async def pass_turns(turns: int) -> float:
    """Return the time (ns) of one `await asyncio.sleep(0)`."""
    start = time.monotonic_ns()
    for _ in range(turns):
        await asyncio.sleep(0)
    return (time.monotonic_ns() - start) / turns


async def by_hand(cycles: int) -> float:
    """Return the time (ns) of one cycle of a loop written by hand with the same components."""
    device, task, coder = EmptyDevice(), EmptyTask(), EmptyCoder()
    learner, policy, rng = EmptyLearner(), EmptyPolicy(), np.random.default_rng(0)
    before = None
    start = time.monotonic_ns()
    for _ in range(cycles):
        sample = await device.read(-1)
        state, reward, terminated, truncated = task.interpret(sample)
        features = coder.encode(state)
        action, probability = policy.choose(learner.action_values(features), rng)
        await device.act(task.commands(action)["device"])
        if before is not None:
            learner.update((*before, reward, features, action, terminated, truncated))
        before = features, action, probability
        await asyncio.sleep(0)
    return (time.monotonic_ns() - start) / cycles


async def by_runtime(cycles: int, instruments: Sequence[object] = ()) -> float:
    """Return the time (ns) of one cycle of the runtime, without opening and ending the run."""
    agent = Agent(EmptyCoder(), EmptyLearner(), EmptyPolicy())
    plan = Plan(limits=Limits(episode_steps=cycles))
    devices = {"device": EmptyDevice()}
    result = await run(devices, EmptyTask(), agent, REACTIVE, plan, instruments=instruments)
    return result.episodes[0].duration / result.episodes[0].steps


async def one_round(cycles: int) -> dict[str, float]:
    return {
        "turn": await pass_turns(cycles),
        "hand": await by_hand(cycles),
        "runtime": await by_runtime(cycles),
        "hooked": await by_runtime(cycles, [OneHook()]),
    }


async def cycle_rounds() -> list[dict[str, float]]:
    await one_round(CYCLES)
    return [await one_round(CYCLES) for _ in range(CYCLE_ROUNDS)]


def cycle_rows() -> Iterator[Row]:
    rounds = clock.run(cycle_rounds(), "real")

    def ratio(kind: str, to: str) -> float:
        return median(figures[kind] / figures[to] for figures in rounds)

    names = {
        "turn": "one await asyncio.sleep(0)",
        "hand": "one cycle of a loop by hand",
        "runtime": "one empty cycle of the runtime",
        "hooked": "the same with an instrument of one hook",
    }
    for kind, name in names.items():
        yield Row(name, median(figures[kind] for figures in rounds) / 1e3, "µs")
    for kind in ("runtime", "hooked"):
        yield Row(f"{names[kind]}, to sleep(0)", ratio(kind, "turn"), "×", 4.0)
        yield Row(f"{names[kind]}, to the loop by hand", ratio(kind, "hand"), "×", 3.0)


# The reaction to an event in a pipe


def write_events(pipe: Connection) -> None:
    """Write the time into the pipe at random intervals, until nobody reads it."""
    intervals = random.Random(0)  # noqa: S311  # nothing secret is drawn
    while True:
        time.sleep(intervals.uniform(SHORTEST, LONGEST))
        try:
            os.write(pipe.fileno(), STAMP.pack(time.monotonic_ns()))
        except BrokenPipeError:
            return


async def bare_reactions(pipe: int) -> list[int]:
    """Return the times (ns) from events to a bare handler."""
    loop, reactions = asyncio.get_running_loop(), list[int]()
    finished = loop.create_future()

    def handle() -> None:
        (stamp,) = STAMP.unpack(os.read(pipe, STAMP.size))
        reactions.append(time.monotonic_ns() - stamp)
        if len(reactions) == EVENTS:
            finished.set_result(None)
            loop.remove_reader(pipe)

    loop.add_reader(pipe, handle)
    await finished
    return reactions


async def hand_reactions(pipe: int, sink: int) -> list[int]:
    """Return the times (ns) from events to the end of act in a loop written by hand."""
    device, task, rng = PipeDevice(pipe, sink), AnswerTask(), np.random.default_rng(0)
    features = Tabular(state=task.state)
    learner, policy = Sarsa(size=features.size, actions=2), Greedy()
    await device.open()
    sample, before = await device.read(-1), None
    for _ in range(EVENTS):
        vector = features.encode((float(sample.values["parity"]),))
        action, probability = policy.choose(learner.action_values(vector), rng)
        await device.act(task.commands(action)["pipe"])
        if before is not None:
            learner.update(Transition(*before, 1.0, vector, action, 0, False, False))
        before = vector, action, probability
        sample = await device.read(sample.sequence)
    await device.close()
    return device.reactions


async def agent_reactions(pipe: int, sink: int) -> tuple[list[int], list[int]]:
    """Return the times (ns) from events to the end of act, as the device saw and as the run reports them."""
    device, task = PipeDevice(pipe, sink), AnswerTask()
    features = Tabular(state=task.state)
    agent = Agent(features, Sarsa(size=features.size, actions=2), Greedy(), np.random.default_rng(0))
    plan = Plan(limits=Limits(episode_steps=EVENTS))
    result = await run({"pipe": device}, task, agent, REACTIVE, plan)
    return device.reactions, result.reaction_times


async def reaction_rounds(pipe: int, sink: int) -> dict[str, list[int]]:
    """Return all times; the first of each round are left out, as they waited while the round began."""
    times: dict[str, list[int]] = {"bare": [], "hand": [], "agent": [], "reported": []}
    for _ in range(REACTION_ROUNDS):
        bare = await bare_reactions(pipe)
        hand = await hand_reactions(pipe, sink)
        agent, reported = await agent_reactions(pipe, sink)
        for kind, figures in (("bare", bare), ("hand", hand), ("agent", agent), ("reported", reported)):
            times[kind] += figures[WARM_UP:]
    return times


def measure_reactions() -> dict[str, list[int]]:
    spawn = multiprocessing.get_context("spawn")
    pipe, other_end = spawn.Pipe(duplex=False)
    writer = spawn.Process(target=write_events, args=(other_end,))
    writer.start()
    other_end.close()
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        return clock.run(reaction_rounds(pipe.fileno(), sink), "real")
    finally:
        pipe.close()
        os.close(sink)
        writer.join()


def reaction_rows() -> Iterator[Row]:
    times = measure_reactions()
    names = {
        "bare": "event to a bare add_reader handler",
        "hand": "event to the end of act, by hand",
        "agent": "event to the end of act, by the runtime",
        "reported": "the same as the run reports it",
    }
    for kind, name in names.items():
        p50, p99 = np.quantile(times[kind], (0.5, 0.99)) / 1e3
        yield Row(f"{name}, p50", float(p50), "µs")
        yield Row(f"{name}, p99", float(p99), "µs")
    yield Row("by the runtime to by hand, p50", median(times["agent"]) / median(times["hand"]), "×")
    yield Row("by the runtime to the bare handler, p50", median(times["agent"]) / median(times["bare"]), "×", 1.3)


def rows() -> Iterator[Row]:
    yield from cycle_rows()
    yield from reaction_rows()


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
