"""Findings on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape

from rtagent.finding import Finding


def tell(console: Console, found: Sequence[Finding]) -> None:
    """Print each finding, with its problem and cure below it."""
    width = max((len(finding.name) for finding in found), default=0)
    for finding in found:
        console.print(f"[bold]{finding.name:<{width}}[/bold]  {escape(finding.value)}")
        if finding.problem:
            console.print(f"{'':<{width}}  [yellow]problem:[/yellow] {escape(finding.problem)}")
            console.print(f"{'':<{width}}  [green]cure:[/green] {escape(finding.cure)}")
