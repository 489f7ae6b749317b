"""Measures what telemetry costs the loop, and what of it arrives.

An agent at 500 Hz with a Horde of 100 demons runs in blocks that take turns, its loop on one processor: without
telemetry, and published and recorded while nobody listens, somebody does, who is then stopped or killed, or while
its own sender is stopped or its disk stalled. For comparison there is a loop without telemetry beside as much
traffic of another program, and somebody who listens to that; and loops with a scheduling priority, and on any
processor, without telemetry and listened to.
"""

from __future__ import annotations

import random
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from _harness import Row, main
from _telemetry_jobs import ANOTHERS, ANYWHERE, PRIORITIZED, PRIORITY, Block, block, complete, interrupted, killed

from rtagent.realtime import Realtime, manners

ROUNDS, SECONDS, LONG = 8, 4.0, 60.0
KILLS, RESAMPLED = 20, 1000
NAMES = {
    "absent": "nobody listening",
    "watched": "somebody listening",
    "stopped": "the listener stopped",
    "killed": "the listener killed",
    "sender stopped": "the sender stopped",
    "disk stalled": "the disk stalled",
    ANOTHERS: "no telemetry, another's traffic",
    f"watched{PRIORITIZED}": f"somebody listening, both{PRIORITIZED}",
    f"watched{ANYWHERE}": f"somebody listening, both{ANYWHERE}",
}
VARIANTS = ("off", f"off{PRIORITIZED}", f"off{ANYWHERE}", *NAMES)

Blocks = dict[str, list[Block]]


def interleaved(folder: Path) -> Blocks:
    blocks: Blocks = {variant: [] for variant in possible()}
    for number in range(ROUNDS):
        for variant in blocks if number % 2 else reversed(blocks):
            blocks[variant].append(block(variant, SECONDS, folder, number))
    return blocks


def possible() -> list[str]:
    """Return the variants that this machine allows; tell why not all."""
    with manners(Realtime(priority=PRIORITY)) as asked:
        for sentence in asked.refused:
            print(sentence, file=sys.stderr)
    return [variant for variant in VARIANTS if not (asked.refused and variant.endswith(PRIORITIZED))]


def cost_rows(blocks: Blocks) -> Iterator[Row]:
    cost = np.concatenate([each.cost for each in blocks["absent"]])
    yield Row("in the loop, a cycle, median", float(np.quantile(cost, 0.5)), "µs", 5.0)
    yield Row("in the loop, a cycle, p99", float(np.quantile(cost, 0.99)), "µs", 15.0)


def lateness_rows(blocks: Blocks) -> Iterator[Row]:
    for quantile, name in ((0.5, "p50"), (0.99, "p99"), (0.999, "p99.9")):
        yield Row(f"lateness without telemetry, {name}", pooled(blocks["off"], quantile), "µs")
        for manner in (PRIORITIZED, ANYWHERE):
            if f"off{manner}" in blocks:
                yield Row(f"  the same{manner}", pooled(blocks[f"off{manner}"], quantile), "µs")
    for variant, name in NAMES.items():
        if variant not in blocks:
            continue
        manner = next((each for each in (PRIORITIZED, ANYWHERE) if variant.endswith(each)), "")
        off = blocks[f"off{manner}"]
        low, ratio, high = compared(off, blocks[variant], 0.99)
        yield Row(f"p99 lateness to that without, {name}", ratio, "×", None if variant == ANOTHERS else 1.1)
        yield Row("  95 % interval, from", low, "×")
        yield Row("  95 % interval, to", high, "×")
        tail = pooled(blocks[variant], 0.999) / pooled(off, 0.999)
        yield Row("  p99.9 lateness to that without", tail, "×")


def pooled(blocks: list[Block], quantile: float) -> float:
    return float(np.quantile(np.concatenate([each.lateness for each in blocks]), quantile))


def compared(off: list[Block], on: list[Block], quantile: float) -> tuple[float, float, float]:
    """Return the median ratio of the quantiles of blocks of one round, between the ends of its interval.

    One block that something else on the machine disturbs moves a median by little. Rounds are drawn many times.
    """
    pairs = zip(on, off, strict=True)
    ratios = np.array([pooled([beside], quantile) / pooled([without], quantile) for beside, without in pairs])
    drawn = np.random.default_rng(0).choice(ratios, (RESAMPLED, len(ratios)))
    low, high = np.quantile(np.median(drawn, axis=1), (0.025, 0.975))
    return float(low), float(np.median(ratios)), float(high)


def arrival_rows(folder: Path) -> Iterator[Row]:
    seen = complete(LONG, folder)
    yield Row(f"records of a run of {LONG:g} s at 1 kHz", seen.records, "")
    yield Row("  told to be lost", seen.lost, "")
    yield Row("  missing at the subscriber, and not told", seen.unaccounted_at_subscriber, "", 0)
    yield Row("  missing in the recording, and not told", seen.unaccounted_in_recording, "", 0)
    yield Row("  age of observations at the subscriber, median", float(np.median(seen.ages)), "ms")
    yield Row("  age of observations at the subscriber, p99", float(np.quantile(seen.ages, 0.99)), "ms", 50.0)


def ending_rows(folder: Path) -> Iterator[Row]:
    rng = random.Random(0)  # noqa: S311  # nothing secret is drawn
    missing = {
        both: [killed(folder, n, rng, with_sender=both) for n in range(both, KILLS, 2)] for both in (False, True)
    }
    yield Row(f"killed {KILLS // 2} times: most that a recording lacks", max(missing[False]), "s", 1.0)
    yield Row(f"killed {KILLS // 2} times with its sender: most that it lacks", max(missing[True]), "s", 1.0)
    yield Row("Ctrl-C to the end of the process", interrupted(folder), "s", 1.0)


def rows() -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        blocks = interleaved(folder)
        yield from cost_rows(blocks)
        yield from lateness_rows(blocks)
        yield from arrival_rows(folder)
        yield from ending_rows(folder)


if __name__ == "__main__":
    sys.exit(main(rows, __doc__))
