"""What a comparison of figures came to: a row for each thing that was compared, with its verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from statistics import median_high

from rtagent.latencies.comparison import Comparison, Ratio
from rtagent.latencies.counts import Counts
from rtagent.latencies.figures import Exact
from rtagent.latencies.rounds import FLOOR
from rtagent.units import describe


class Verdict(StrEnum):
    """What became of a thing; the first three are regressions."""

    SLOWER = "slower"
    MORE = "more"
    MISSED = "missed"
    UNSURE = "not sure"
    TOO_FEW = "too few"
    SAME = ""
    QUICKER = "quicker"
    FEWER = "fewer"
    MACHINE = "the machine"

    @property
    def regression(self) -> bool:
        """Whether something got worse, surely."""
        return self in (Verdict.SLOWER, Verdict.MORE, Verdict.MISSED)

    @property
    def undecided(self) -> bool:
        """Whether nothing can be said."""
        return self in (Verdict.UNSURE, Verdict.TOO_FEW)


@dataclass(frozen=True)
class Change:
    """A row: what, in words how it was, how it is and how it changed, and the verdict; `ratio` where it is one."""

    what: str
    before: str
    now: str
    by: str
    verdict: Verdict
    ratio: Ratio | None = None

    def __str__(self) -> str:
        by = f", {self.by}" if self.by else ""
        return f"{self.what}: {self.before} before, {self.now} now{by}"


@dataclass(frozen=True)
class Compared:
    """A scenario compared: its changes, what could not be compared, and reaction times (ns) to draw."""

    name: str
    before: str
    limit: float
    changes: Sequence[Change]
    notes: Sequence[str] = ()
    reactions: tuple[Sequence[int], Sequence[int]] = field(default=((), ()))

    @property
    def title(self) -> str:
        """What was compared with what."""
        return f"{self.name}, compared with {self.before}"

    def said(self) -> str:
        """Return a sentence on what it came to."""
        if self.regressions:
            return f"{len(self.regressions)} got worse: {'; '.join(map(str, self.regressions))}."
        unsure = ", ".join(change.what for change in self.undecided)
        if not self.changes:
            return "Nothing could be compared."
        rest = f"; of {unsure} nothing can be said" if unsure else ""
        return f"No regression: nothing takes surely more than {self.limit:g} × as long, no count is higher{rest}."

    @property
    def regressions(self) -> list[Change]:
        """What got worse."""
        return [change for change in self.changes if change.verdict.regression]

    @property
    def undecided(self) -> list[Change]:
        """What nothing can be said of."""
        return [change for change in self.changes if change.verdict.undecided]


def of_times(comparison: Comparison, limit: float) -> Iterator[Change]:
    """Yield a change for each time that was compared, and for each that had too few."""
    for name, ratio in comparison.ratios.items():
        verdict = Verdict.MACHINE if name == FLOOR else Verdict(ratio.verdict(limit))
        yield Change(name, describe(ratio.before), describe(ratio.after), ratio.said(), verdict, ratio)
    for name, count in comparison.worth_telling().items():
        yield Change(name, "", "", f"only {count} in a round: run more episodes", Verdict.TOO_FEW)


def of_exact(before: Exact, now: Exact) -> Iterator[Change]:
    """Yield the changes of what is the same in every run: of reactions, and of counts by name."""
    yield from _of_reactions(before.reactions, now.reactions)
    for what, counts in now.counts.items():
        if what in before.counts and before.counts[what].note == counts.note:
            yield from _of_counts(before.counts[what], counts)


def uncounted(before: Exact, now: Exact) -> Iterator[str]:
    """Yield a sentence for each count that is on one side only, or was taken in another way."""
    yield from dict.fromkeys([*before.notes, *now.notes])
    for what, counts in now.counts.items():
        if what in before.counts and before.counts[what].note != counts.note:
            notes = " and ".join(note or "all" for note in (before.counts[what].note, counts.note))
            yield f"{what} were counted in two ways, and are not compared: {notes}."


def _of_reactions(before: Sequence[int], now: Sequence[int]) -> Iterator[Change]:
    if len(now) != len(before):
        verdict = Verdict.MISSED if len(now) < len(before) else Verdict.SAME
        yield Change("reactions (virtual)", str(len(before)), str(len(now)), "", verdict)
    for name, of in (("median", median_high), ("longest", max)) if before and now else ():
        then, here = of(before), of(now)
        verdict = Verdict.SLOWER if here > then else Verdict.QUICKER if here < then else Verdict.SAME
        by = f"{here - then:+,} ns" if here != then else "exactly"
        yield Change(f"reaction, {name} (virtual)", describe(then), describe(here), by, verdict)


def _of_counts(before: Counts, now: Counts) -> Iterator[Change]:
    more = now.more_than(before)
    verdict = Verdict.FEWER if now.total < before.total and not more else Verdict.SAME
    yield Change(f"{now.what} in a cycle", f"{before.total:g}", f"{now.total:g}", "exactly", verdict)
    for name, (then, here) in more.items():
        yield Change(f"{now.what} in {name}", f"{then:g}", f"{here:g}", f"{here - then:+g} a cycle", Verdict.MORE)
