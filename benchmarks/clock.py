"""Measures the clocks: timer events a second and the stopping task in virtual time, sleeps in real time."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from statistics import median
from typing import Any

import numpy as np
from _harness import Row, main
from numpy.random import Generator

from rtagent import Agent, Limits, Plan, Result, Schedule, clock, ms, run, second
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import Greedy
from rtagent.tasks import Stopping
from rtagent_drivers.stopping import stopping_joint

ROUNDS = 5
TIMERS, FIRINGS = 100, 1_000

TRIALS, EPISODES = 30, 20
LEARN_DELAY = 50 * ms
LEARNED_AFTER = 10
"""In the episodes from this one on, the agent has learned to stop."""

SLEEPS_MS = (0.1, 1.37, 10.0)
SLEEPS_A_ROUND = 40


# Timer events in virtual time


async def sleeping_tasks() -> None:
    async def sleeper(number: int) -> None:
        for _ in range(FIRINGS):
            await asyncio.sleep(0.001 + number * 1e-6)

    await asyncio.gather(*(sleeper(number) for number in range(TIMERS)))


async def callbacks() -> None:
    loop = asyncio.get_running_loop()
    finished = loop.create_future()
    left = TIMERS * FIRINGS

    def fire(delay: float) -> None:
        nonlocal left
        left -= 1
        if left > 0:
            loop.call_later(delay, fire, delay)
        elif not finished.done():
            finished.set_result(None)

    for number in range(TIMERS):
        loop.call_later(0.001, fire, 0.001 + number * 1e-6)
    await finished


def events_a_second(events: Callable[[], Coroutine[Any, Any, None]]) -> float:
    start = time.perf_counter()
    clock.run(events(), "virtual")
    return TIMERS * FIRINGS / (time.perf_counter() - start)


def timer_rows() -> Iterator[Row]:
    kinds = {"tasks that sleep": sleeping_tasks, "call_later": callbacks}
    rounds = [{name: events_a_second(kind) for name, kind in kinds.items()} for _ in range(ROUNDS)]
    for name in kinds:
        rate = median(figures[name] for figures in rounds)
        yield Row(f"virtual timer events, {name}", rate, "1/s", 100_000, "higher")


# The stopping task in virtual time


def stopping(preset: str) -> tuple[Result, float]:
    """Run the stopping task; return its result and the wall time in seconds."""
    task = Stopping()
    features = Tabular(state=task.state)
    schedule = Schedule.preset(preset, learn_delay=LEARN_DELAY)
    plan = Plan(TRIALS, EPISODES, limits=Limits(episode_time=10 * second))

    def new_agent(rng: Generator) -> Agent:
        return Agent(features, Sarsa(size=features.size, actions=2), Greedy(), rng)

    async def trials() -> Result:
        return await run({"joint": stopping_joint()}, task, new_agent, schedule, plan)

    start = time.perf_counter()
    result = clock.run(trials(), "virtual")
    return result, time.perf_counter() - start


def reactions_over_delay(result: Result) -> list[float]:
    """Return the reaction times of the learned episodes, in units of the learning delay."""
    learned = [record for record in result.episodes if record.episode >= LEARNED_AFTER]
    return [reaction.time / LEARN_DELAY for record in learned for reaction in record.reactions.reactions]


def stopping_rows() -> Iterator[Row]:
    for preset, earliest in (("reactive", 0.0), ("standard", 1.0)):
        result, wall = stopping(preset)
        reactions = reactions_over_delay(result)
        middle, expected = median(reactions), earliest + 0.5
        name = f"stopping, {preset}"
        yield Row(f"{name}: wall time of {TRIALS} × {EPISODES} episodes", wall, "s", 10.0)
        yield Row(f"{name}: reaction median", middle, "D")
        yield Row(f"{name}: reaction median, distance from {expected} D", abs(middle - expected), "D", 0.1)
        yield from uniformity_rows(name, reactions, earliest)


def uniformity_rows(name: str, reactions: list[float], earliest: float) -> Iterator[Row]:
    try:
        from scipy import stats
    except ImportError:
        return
    p_value = stats.kstest(reactions, "uniform", args=(earliest, 1.0)).pvalue
    range_ = f"{earliest:g} to {earliest + 1:g} D"
    yield Row(f"{name}: Kolmogorov-Smirnov p, uniform from {range_}", p_value, "", 0.01, "higher")


# Sleeps in real time


async def lateness(duration: float) -> list[float]:
    """Return by how many ms each of some sleeps of `duration` (ms) ended late."""
    late = []
    for _ in range(SLEEPS_A_ROUND):
        start = time.perf_counter_ns()
        await asyncio.sleep(duration / 1e3)
        late.append((time.perf_counter_ns() - start) / ms - duration)
    return late


def kernel_lateness(duration: float) -> list[float]:
    """Return the same for sleeps without an event loop: what the machine itself adds."""
    late = []
    for _ in range(SLEEPS_A_ROUND):
        start = time.perf_counter_ns()
        time.sleep(duration / 1e3)
        late.append((time.perf_counter_ns() - start) / ms - duration)
    return late


def sleep_rounds(duration: float, plain_thread: ThreadPoolExecutor) -> dict[str, list[float]]:
    late: dict[str, list[float]] = {"real clock": [], "plain asyncio": [], "time.sleep": []}
    for _ in range(ROUNDS):
        late["real clock"] += clock.run(lateness(duration), "real")
        late["plain asyncio"] += plain_thread.submit(asyncio.run, lateness(duration)).result()
        late["time.sleep"] += kernel_lateness(duration)
    return late


def sleep_rows() -> Iterator[Row]:
    # Plain asyncio has a thread of its own, made before the real clock asks for finer timers in this one.
    with ThreadPoolExecutor(1) as plain_thread:
        plain_thread.submit(asyncio.run, lateness(0.0)).result()
        for duration in SLEEPS_MS:
            for kind, late in sleep_rounds(duration, plain_thread).items():
                p50, p99 = np.quantile(late, (0.5, 0.99))
                name = f"sleep of {duration:g} ms, {kind}: lateness"
                yield Row(f"{name} p50", float(p50), "ms", 0.2 if kind == "real clock" else None)
                yield Row(f"{name} p99", float(p99), "ms")


def rows() -> Iterator[Row]:
    yield from timer_rows()
    yield from stopping_rows()
    yield from sleep_rows()


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
