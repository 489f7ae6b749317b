"""What a run came to, for people: a table of times, a small histogram of reactions, counters and faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TextIO

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from rtagent.recorder import Fault
from rtagent.result import Result
from rtagent.summary import Summary
from rtagent.units import describe

BINS = 10
BAR_WIDTH = 40
FAULTS = 10
"""So many different faults have a line of their own."""


def print_report(result: Result, out: TextIO) -> None:
    """Print a result."""
    console = Console(file=out, highlight=False)
    console.print()
    console.print(_times(result))
    if result.reaction_times:
        console.print("\n[bold]reaction times[/bold]")
        for line in histogram(result.reaction_times):
            console.print(line)
    _print_returns(console, result)
    _print_learning(console, result)
    _print_predictions(console, result)
    _print_counters(console, result)
    shown = _shown(result.faults)
    for fault in shown:
        times = f" ({fault.count} times)" if fault.count > 1 else ""
        console.print(
            f"[bold]fault[/bold] at {describe(fault.time)}: {escape(fault.source)}: {escape(fault.message)}{times}"
        )
    if len(shown) < len(result.faults):
        console.print(f"and {len(result.faults) - len(shown)} other sentences of this kind; --json has them.")


def _shown(faults: Sequence[Fault]) -> Sequence[Fault]:
    """Return the faults that are worth a line each: the fatal ones, and the first of the others."""
    fatal = [fault for fault in faults if fault.fatal]
    return [fault for fault in faults if not fault.fatal][:FAULTS] + fatal


def _times(result: Result) -> Table:
    table = Table("time", "count", "median", "p90", "p99", "max", "missed", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    rows: list[tuple[str, Summary, bool]] = [("reaction", result.reaction_time, True)]
    rows += [(f"  {part}", summary, False) for part, summary in result.reaction_parts().items()]
    rows += [("response", result.response_time, True)]
    rows += [(name, summary, False) for name, summary in result.components().items()]
    for name, summary, misses in rows:
        if summary.count or summary.missed:
            table.add_row(name, *_cells(summary), str(summary.missed) if misses else "")
    return table


def _cells(summary: Summary) -> list[str]:
    times = (summary.median, summary.p90, summary.p99, summary.maximum)
    return [str(summary.count), *(describe(time) if summary.count else "" for time in times)]


def histogram(times: Sequence[int]) -> list[str]:
    """Return a histogram of times (ns) as lines of text, one for each of ten equal parts."""
    counts, edges = np.histogram(times, bins=BINS, range=(0, max(times) or 1))
    width = max(len(describe(edge)) for edge in edges)
    return [
        f"  {describe(edges[i]):>{width}} to {describe(edges[i + 1]):>{width}}  {_bar(count, counts.max())} {count}"
        for i, count in enumerate(counts)
    ]


def _bar(count: int, most: int) -> str:
    return "█" * round(BAR_WIDTH * count / most)


def _print_returns(console: Console, result: Result) -> None:
    returns = [episode.total_reward for episode in result.episodes if episode.finished]
    if returns and (result.schedule.acts or any(returns)):
        last = returns[-10:]
        console.print(
            f"\nreturn: mean {np.mean(returns):.4g} over {len(returns)} episodes, "
            f"{np.mean(last):.4g} over the last {len(last)}"
        )


def _print_learning(console: Console, result: Result) -> None:
    """Print how transitions were learned, where that is more than in place and in one piece."""
    learning = result.learning()
    happened = {how: count for how, count in learning.counts.items() if count}
    if happened.keys() <= {"in place"} and not learning.slices.count:
        return
    told = ", ".join(f"{count:,} {how}" for how, count in happened.items())
    slices = learning.slices
    cut = f"; slices: median {describe(slices.median)}, p99 {describe(slices.p99)}" if slices.count else ""
    console.print(f"\nlearning: {learning.share:.0%} of the time; {told}{cut}")


def _print_predictions(console: Console, result: Result) -> None:
    predictions = result.predictions(len(result.agents) - 1) if result.agents else {}
    if not predictions:
        return
    table = Table("prediction", "mean error", "rms error", "RUPEE", "verified", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"
    for name, errors in predictions.items():
        told = ("" if value is None else f"{value:.4g}" for value in (errors.mae, errors.rmse, errors.rupee))
        table.add_row(escape(name), *told, f"{errors.verified:,}")
    console.print()
    console.print(table)


def _print_counters(console: Console, result: Result) -> None:
    counts = {name: count for name, count in result.recorder.counters.items() if count}
    counts |= {
        f"{device}.{name}": count
        for device, counters in result.device_counters.items()
        for name, count in counters.items()
    }
    if result.anticipated:
        counts["anticipated_stimuli"] = result.anticipated
    if counts:
        console.print("counted: " + ", ".join(f"{escape(name)} {count}" for name, count in sorted(counts.items())))
