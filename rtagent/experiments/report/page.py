"""The page: HTML that stands alone, with its figures inside, for light and dark screens and for paper."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from rtagent.experiments.experiment import Claim, Table, Verdict
from rtagent.experiments.outcome import Drawn, Failed, Outcome

LARGE = 1_000_000
"""Bytes of an SVG above which the page shows the PNG instead."""
MARKS = {
    Verdict.REPRODUCED: "✓",
    Verdict.DIFFERS: "≈",
    Verdict.NOT_REPRODUCED: "✗",
    Verdict.UNDECIDED: "?",
}
THESIS = "Jaden B. Travnik, Reinforcement Learning on Resource Bounded Systems"


@dataclass(frozen=True)
class About:
    """How the report was made: the command, when, how long (in words) it took, with what and on what."""

    command: str
    when: str
    took: str
    versions: str
    machine: str
    quick: bool


def page(outcomes: Sequence[Outcome], about: About) -> str:
    """Return the whole page."""
    css = Path(__file__).with_name("style.css").read_text(encoding="utf-8")
    parts = [*_head(outcomes, about), *(_section(outcome) for outcome in outcomes)]
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>The thesis, run again</title>\n<style>\n{css}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _head(outcomes: Sequence[Outcome], about: About) -> Iterator[str]:
    yield "<h1>The thesis, run again</h1>"
    yield f"<p>{escape(THESIS)}: what it claims, beside what rtagent found.</p>"
    if about.quick:
        yield "<p><strong>This is the quick form</strong>: fewer seeds and smaller sets than the thesis has.</p>"
    yield (
        f'<p class="faint">{escape(about.when)}, <code>{escape(about.command)}</code>, took {escape(about.took)}.'
        f"<br>{escape(about.versions)}<br>{escape(about.machine)}</p>"
    )
    yield _overview(outcomes)
    yield (
        '<p class="faint">A verdict follows from intervals over seeds (95 %, bootstrap): <em>reproduced</em>, the '
        "claim holds throughout the interval; <em>not reproduced</em>, it holds nowhere in it; <em>undecided</em>, "
        "the interval has both; <em>differs</em>, the direction is the thesis's and the size is not.</p>"
    )


def _overview(outcomes: Sequence[Outcome]) -> str:
    head = ("experiment", "thesis", *MARKS, "failed")
    rows = [[_link(outcome), escape(outcome.experiment.thesis), *_counts(outcome)] for outcome in outcomes]
    return _table("", [escape(name) for name in head], rows)


def _link(outcome: Outcome) -> str:
    return f'<a href="#{escape(outcome.experiment.name)}">{escape(outcome.experiment.title)}</a>'


def _counts(outcome: Outcome) -> list[str]:
    counts = Counter(claim.verdict for claim in outcome.findings.claims)
    return [str(counts[verdict] or "") for verdict in MARKS] + ["yes" if outcome.failures else ""]


def _section(outcome: Outcome) -> str:
    experiment, findings = outcome.experiment, outcome.findings
    parts = [
        f'<section id="{escape(experiment.name)}">\n<h2>{escape(experiment.title)}</h2>',
        f'<p class="faint">{escape(experiment.thesis)}. {_done(outcome)}</p>',
        *map(_failed, outcome.failures),
        _claims(findings.claims) if findings.claims else "",
        *map(_figure, outcome.figures),
        *map(_given_table, findings.tables),
        _listed("Notes", findings.notes),
        _listed("What the simulated devices model, and what not", experiment.models),
        "</section>",
    ]
    return "\n".join(filter(None, parts))


def _done(outcome: Outcome) -> str:
    seeds = outcome.seeds
    told = f"{len(outcome.cells)} cells, {outcome.seconds:,.0f} s of one processor"
    if seeds:
        one_after_another = len(seeds) > 1 and seeds[-1] - seeds[0] == len(seeds) - 1
        told += (
            f", seeds {seeds[0]} to {seeds[-1]}" if one_after_another else f", seeds {', '.join(map(str, seeds))}"
        )
    return f"{told}; <code>rtagent reproduce {escape(outcome.experiment.name)}</code>."


def _failed(failed: Failed) -> str:
    trace = f"<details><summary>where</summary><pre>{escape(failed.trace)}</pre></details>" if failed.trace else ""
    return f'<div class="failed"><strong>Failed:</strong> {escape(failed.sentence)}{trace}</div>'


def _claims(claims: Sequence[Claim]) -> str:
    rows = [[escape(claim.said), escape(claim.theirs), _ours(claim), _verdict(claim.verdict)] for claim in claims]
    return _table("", ["the claim", "the thesis", "here", "verdict"], rows)


def _ours(claim: Claim) -> str:
    because = f'<p class="faint">{escape(claim.because)}</p>' if claim.because else ""
    return escape(claim.ours) + because


def _verdict(verdict: Verdict) -> str:
    kind = verdict.value.replace(" ", "-")
    return f'<span class="verdict {kind}">{MARKS[verdict]} {verdict.value}</span>'


def _figure(drawn: Drawn) -> str:
    small = drawn.svg.stat().st_size < LARGE
    kind, file = ("svg+xml", drawn.svg) if small else ("png", drawn.png)
    data = base64.b64encode(file.read_bytes()).decode()
    links = ", ".join(
        f'<a href="{drawn.png.parent.name}/{each.name}">{each.name}</a>' for each in (drawn.png, drawn.svg)
    )
    return (
        f'<figure><img alt="{escape(drawn.caption)}" src="data:image/{kind};base64,{data}">'
        f"<figcaption>{escape(drawn.caption)} ({links})</figcaption></figure>"
    )


def _given_table(table: Table) -> str:
    return _table(escape(table.caption), map(escape, table.head), [map(escape, row) for row in table.rows])


def _table(caption: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    top = "".join(f'<th scope="col">{name}</th>' for name in head)
    body = "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    said = f"<caption>{caption}</caption>" if caption else ""
    return f'<div class="wide"><table>{said}<thead><tr>{top}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'


def _listed(title: str, sentences: Sequence[str]) -> str:
    items = "\n".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f"<h3>{title}</h3>\n<ul>\n{items}\n</ul>" if sentences else ""
