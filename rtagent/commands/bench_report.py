"""What a bench came to, for people: tables and histograms on the terminal, Markdown for pull requests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TextIO

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from rtagent.commands.report import histogram
from rtagent.latencies.changes import Change, Compared, Verdict
from rtagent.latencies.figures import Figures
from rtagent.latencies.rounds import FLOOR, Rounds
from rtagent.summary import Summary
from rtagent.units import describe

BINS, BAR_WIDTH = 8, 30
WIDTH = 116
"""In characters, where there is no terminal that has one."""
COLOURS = {Verdict.MACHINE: "dim", Verdict.UNSURE: "yellow", Verdict.TOO_FEW: "yellow", Verdict.SAME: "default"}
HEAD = ("", "before", "now", "change", "verdict")


def print_figures(figures: Figures, out: TextIO) -> None:
    """Print what was measured of a scenario."""
    console = _console(out)
    console.print(f"\n[bold]{escape(figures.name)}[/bold]")
    table = _table("", "median", "lowest and highest round")
    for name, medians in figures.times.values.items():
        spread = f"{describe(min(medians))} to {describe(max(medians))}"
        table.add_row(name, describe(float(np.median(medians))), spread)
    for what, counts in figures.exact.counts.items():
        table.add_row(f"{what} in a cycle", f"{counts.total:g}", "exactly")
    console.print(table)
    if reactions := figures.reactions or figures.exact.reactions:
        _print_lines(console, "reaction times", histogram(reactions))
    _print_notes(console, [*figures.exact.notes, *filter(None, [figures.busy])])


def print_compared(compared: Compared, out: TextIO) -> None:
    """Print what became of a scenario."""
    console = _console(out)
    console.print(f"\n[bold]{escape(compared.title)}[/bold]")
    table = _table(*HEAD)
    for change in compared.changes:
        colour = COLOURS.get(change.verdict, "red" if change.verdict.regression else "green")
        table.add_row(*map(escape, _cells(change)), f"[{colour}]{change.verdict}[/{colour}]")
    console.print(table)
    if all(compared.reactions):
        _print_lines(console, "reaction times: before ░, now █", two_histograms(*compared.reactions))
    _print_notes(console, compared.notes)
    console.print(f"\n{escape(compared.said())}")


def print_floor(rounds: Rounds, out: TextIO) -> None:
    """Print how late a machine wakes an event loop that does nothing else."""
    console = _console(out)
    blocks = [each.blocks[0][FLOOR] for each in rounds.kept]
    summary = Summary.of([time for block in blocks for time in block])
    medians = [float(np.median(block)) for block in blocks]
    table = _table("a bare wake-up, late by", "median", "p90", "p99", "max")
    times = (summary.median, summary.p90, summary.p99, summary.maximum)
    table.add_row(f"{summary.count} sleeps of 1 ms", *map(describe, times))
    console.print(table)
    _print_lines(
        console, "how late", histogram([time for block in blocks for time in block if time <= summary.p99])
    )
    console.print(f"\nThe medians of {rounds.said()[:-1]}: {describe(min(medians))} to {describe(max(medians))}.")
    console.print(f"Others had the processor for up to {rounds.most_lost:.1%} of a round.")


def as_markdown(scenarios: Sequence[Compared]) -> str:
    """Return a summary for a pull request."""
    return "\n".join(line for compared in scenarios for line in _markdown(compared))


def two_histograms(before: Sequence[int], now: Sequence[int]) -> list[str]:
    """Return histograms of two sets of times (ns) on one scale, as lines; a bar is a share of its set."""
    most = max(*before, *now, 1)
    edges = np.linspace(0, most, BINS + 1)
    shares = [np.histogram(times, bins=edges)[0] / len(times) for times in (before, now)]
    scale, width = BAR_WIDTH / max(each.max() for each in shares), max(len(describe(edge)) for edge in edges)
    lines = []
    for number in range(BINS):
        place = f"{describe(edges[number]):>{width}} to {describe(edges[number + 1]):>{width}}"
        bars = [mark * round(share[number] * scale) for mark, share in zip("░█", shares, strict=True)]
        lines += [f"  {place}  {bars[0]}", f"  {'':{len(place)}}  {bars[1]}"]
    return lines


def _markdown(compared: Compared) -> list[str]:
    head = [f"### {compared.title}", "", compared.said(), ""]
    rows = [f"| {' | '.join(HEAD)} |", "|---|--:|--:|--:|---|"]
    for change in compared.changes:
        verdict = f"**{change.verdict}**" if change.verdict.regression else str(change.verdict)
        rows.append(f"| {' | '.join([*_cells(change), verdict])} |".replace("<", "&lt;"))
    notes = [f"- {' '.join(note.split())}" for note in compared.notes]
    return [*head, *rows, "", *notes, *[""] * bool(notes)]


def _cells(change: Change) -> tuple[str, str, str, str]:
    return change.what, change.before, change.now, change.by


def _console(out: TextIO) -> Console:
    return Console(file=out, highlight=False, soft_wrap=True, width=None if out.isatty() else WIDTH)


def _table(first: str, *columns: str) -> Table:
    table = Table(first, *columns, box=None, pad_edge=False)
    table.columns[0].overflow = "fold"
    for column in table.columns[1:4]:
        column.justify = "right"
    return table


def _print_lines(console: Console, title: str, lines: Sequence[str]) -> None:
    console.print(f"\n[bold]{title}[/bold]")
    for line in lines:
        console.print(line)


def _print_notes(console: Console, notes: Sequence[str]) -> None:
    for note in notes:
        console.print(f"note: {escape(note)}")
