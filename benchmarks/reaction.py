"""Measures how quickly an agent reacts while it learns.

Events come from another process through a pipe, 500 a second. Learning is jobs of 500 ms, of which one always
waits; the runtime cuts them between pieces of 35 µs, which is what pieces of a Horde take. The agent that does not
learn at all runs in between. Events are written on one processor and answered on another, where there are two.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
from _harness import Row, main
from _jobs import Block, Variant, Work, block, events
from _urgent import PERIOD, TURN, deferred_run, difference_to_inline

from rtagent import Result, Schedule, clock
from rtagent.learn import Learn, Where
from rtagent.realtime import Realtime, manners
from rtagent.runtime import NO_HABITS, Habits
from rtagent.scenario import assemble, load
from rtagent.schedule import ACT, CHOOSE, OBSERVE, PRESETS

SCENARIOS = Path(__file__).parent.parent / "scenarios"
ROUNDS, SECONDS = 6, 2.0
RESAMPLED = 500
PRIORITY = 50
OBJECTS, LOGGED = 300_000, 100

ROOM = 1_000_000
"""The transitions of events wait behind the jobs: there is room for all of them."""

SLICE = PRESETS["interruptible"].learn.slice
REALTIME = Realtime(priority=PRIORITY)

FROZEN = Variant("no learning", Schedule((OBSERVE, CHOOSE, ACT)))
INTERRUPTIBLE = Variant("interruptible", Schedule.preset("interruptible", learn=Learn(slice=SLICE, queue=ROOM)))
BACKGROUND = Variant("background", Schedule.preset("background", learn=Learn(where=Where.THREAD, queue=ROOM)))
OWN_VALUES = replace(BACKGROUND, name="background, learning the action values", apart=False)
FROZEN_FIRST = replace(FROZEN, name="no learning, with priority", realtime=REALTIME)
BACKGROUND_FIRST = replace(BACKGROUND, name="background, with priority", realtime=REALTIME)
OWN_VALUES_FIRST = replace(OWN_VALUES, name=f"{OWN_VALUES.name}, with priority", realtime=REALTIME)
HEAPED = replace(INTERRUPTIBLE, name="garbage collected as Python does", logged=LOGGED)
CALM = replace(HEAPED, name="garbage collected in calm moments", realtime=Realtime(gc="calm"))

Blocks = dict[str, list[Block]]


# Events in a pipe, and jobs of learning


@contextmanager
def answered_here() -> Iterator[int]:
    """Write events on the last processor, and be on the first."""
    before = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, before[-1:])
    try:
        with events() as pipe:
            os.sched_setaffinity(0, before[:1])
            yield pipe
    finally:
        os.sched_setaffinity(0, before)


def interleaved(*variants: Variant) -> Blocks:
    """Run blocks of each variant, forwards and backwards in turn."""
    blocks: Blocks = {variant.name: [] for variant in variants}
    work, sink = Work(), os.open(os.devnull, os.O_WRONLY)
    with answered_here() as pipe:
        for turn in range(ROUNDS):
            for variant in variants if turn % 2 else reversed(variants):
                blocks[variant.name].append(with_manners((pipe, sink), work, variant))
    os.close(sink)
    return blocks


def with_manners(ends: tuple[int, int], work: Work, variant: Variant) -> Block:
    with manners(variant.realtime) as granted:
        habits = Habits(granted.calm, granted.place_learner) if variant.realtime != Realtime() else NO_HABITS
        measured = granted.run(block(ends, work, variant, SECONDS, habits))
    for sentence in granted.refused:
        print(f"note: {sentence}", file=sys.stderr)
    return measured


def quantile(blocks: Sequence[Block], q: float) -> float:
    """Return a quantile (µs) of all reaction times."""
    return float(np.quantile(np.concatenate([each.reactions for each in blocks]), q)) / 1e3


def interval(blocks: Sequence[Block], base: Sequence[Block], q: float) -> tuple[float, float]:
    """Return the 95 % interval of the ratio of two quantiles, by drawing rounds anew."""
    rng = np.random.default_rng(0)
    drawn = [rng.integers(len(base), size=len(base)) for _ in range(RESAMPLED)]
    ratios = [quantile([blocks[i] for i in d], q) / quantile([base[i] for i in d], q) for d in drawn]
    low, high = np.quantile(ratios, (0.025, 0.975))
    return float(low), float(high)


def compared(
    blocks: Blocks, variant: Variant, base: Variant, p50: float | None = None, p99: float | None = None
) -> Iterator[Row]:
    """Yield quantiles of a variant, and their ratios to those of another; the ratios may have reaches."""
    these, others = blocks[variant.name], blocks[base.name]
    for name, q, reach in (("p50", 0.5, p50), ("p99", 0.99, p99)):
        yield Row(f"{variant.name}, {name}", quantile(these, q), "µs")
        if variant is not base:
            low, high = interval(these, others, q)
            ratio = quantile(these, q) / quantile(others, q)
            yield Row(f"{variant.name}, {name}, to {base.name} ({low:.2f} to {high:.2f})", ratio, "×", reach)


def learning_rows() -> Iterator[Row]:
    blocks = interleaved(FROZEN, INTERRUPTIBLE, BACKGROUND, OWN_VALUES)
    yield from compared(blocks, FROZEN, FROZEN)
    yield from compared(blocks, INTERRUPTIBLE, FROZEN, p50=1.0, p99=1.0)
    these = blocks[INTERRUPTIBLE.name]
    share, worked = (
        100 * mean(parts) for parts in zip(*((each.share, each.worked) for each in these), strict=True)
    )
    yield Row("interruptible, share of the processor for learning", share, "%", 85.0, "higher")
    yield Row("interruptible, work done, to that of nothing else", worked, "%")
    yield from compared(blocks, BACKGROUND, FROZEN, p50=1.2)
    yield from compared(blocks, OWN_VALUES, FROZEN)


def priority_rows() -> Iterator[Row]:
    blocks = interleaved(FROZEN_FIRST, BACKGROUND_FIRST, OWN_VALUES_FIRST)
    yield from compared(blocks, FROZEN_FIRST, FROZEN_FIRST)
    yield from compared(blocks, BACKGROUND_FIRST, FROZEN_FIRST, p50=1.2, p99=2.0)
    yield from compared(blocks, OWN_VALUES_FIRST, FROZEN_FIRST)


def garbage_rows() -> Iterator[Row]:
    heap = [[number] for number in range(OBJECTS)]
    blocks = interleaved(HEAPED, CALM)
    for name, these in blocks.items():
        for q in (0.99, 0.999):
            yield Row(f"{len(heap):,} objects, {name}, p{100 * q:g}", quantile(these, q), "µs")


# Scenarios


def result_of(scenario: str, clock_name: clock.ClockName, **settings: object) -> Result:
    """Run a scenario with other settings; `run__trials=3` is run.trials = 3."""
    changed = [f"{key.replace('__', '.')}={value}" for key, value in settings.items()]
    assembly = assemble(load(SCENARIOS / scenario, [f"run.clock={clock_name}", *changed]))
    return clock.run(assembly.run(), clock_name)


def stopping_rows() -> Iterator[Row]:
    """Yield medians; that of a uniform draw of 500 ms has itself an error of 250 ms / √n."""
    for preset, expected, trials in (("standard", 750, 25), ("reactive", 250, 25)):
        result = result_of(
            "stopping.toml", "virtual", schedule__preset=preset, schedule__learn_delay="500ms", run__trials=trials
        )
        median = result.reaction_time.median / 1e6
        yield Row(f"stopping, 500 ms of learning, {preset}, median", median, "ms")
        yield Row(f"the same, distance to {expected} ms", abs(median - expected), "ms", 50.0)
    result = result_of(
        "stopping.toml", "virtual", schedule__preset="interruptible", schedule__learn_delay="500ms", run__trials=2
    )
    yield Row("stopping, 500 ms of learning, interruptible, median", result.reaction_time.median / 1e6, "ms", 0.2)


def not_learned(result: Result) -> int:
    """Return how many transitions were closed and not learned."""
    counters: dict[str, Any] = result.as_dict()["learning"]
    learned = sum(count for name, count in counters.items() if name.startswith("learned_"))
    return sum(episode.steps for episode in result.episodes) - int(learned)


def horde_rows() -> Iterator[Row]:
    for bins in (133, 1338):
        result = result_of("stopping_horde.toml", "real", horde__demons__0__bins=bins)
        demons = len(result.agents[0].learner.horde)
        name = f"stopping, {demons:,} demons"
        yield Row(f"{name}, p50", result.reaction_time.median / 1e3, "µs")
        yield Row(f"{name}, p99", result.reaction_time.p99 / 1e3, "µs", 1000.0)
        yield Row(f"{name}, transitions not learned", not_learned(result), "", 0.0)


def deferred_rows() -> Iterator[Row]:
    result, transitions = clock.run(deferred_run(), "virtual")
    queue = result.recorder.queue_length
    bound = TURN / PERIOD + 2
    yield Row("deferred, urgent half of the time, most that waited", queue.maximum, "", bound)
    yield Row("deferred, transitions not learned", not_learned(result), "", 0.0)
    yield Row("deferred, weights, difference to inline", difference_to_inline(result, transitions), "", 0.0)


def rows() -> Iterator[Row]:
    yield from learning_rows()
    yield from priority_rows()
    yield from stopping_rows()
    yield from horde_rows()
    yield from deferred_rows()
    yield from garbage_rows()


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
