"""Interleaved rounds: what is to be compared takes turns, so that the mood of a machine meets all of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rtagent import clock
from rtagent.errors import SpecError, UndecidedError
from rtagent.latencies.host import Disturbance, bound_to, watched
from rtagent.latencies.subject import Subject
from rtagent.latencies.times import AGE, ages_of, learning_of, times_of
from rtagent.latency import sleeps
from rtagent.result import Result
from rtagent.units import describe, ms

LEAST_ROUNDS = 5
"""Fewer rounds have no interval to speak of."""

FLOOR = "wake-up"
FLOOR_LASTS = 200 * ms

LEARNING = "learning"

Block = Mapping[str, Sequence[int]]
"""Times (ns) by name, from one run."""
Tell = Callable[[str], None]
"""Hears a line on how far something is."""


@dataclass(frozen=True)
class Measure:
    """What is measured: `run` runs it once; its thread is this one, or that of a `schedstat` of its own."""

    run: Callable[[], Block]
    schedstat: Path | None = None


@dataclass(frozen=True)
class Rules:
    """How is measured.

    `rounds` count, after `warm_up` that do not. A round in which others had the processor for more than `stolen` of
    the time is set aside. `confidence` is that of intervals; `processor` the one to measure on (None: the last).
    A round needs at least `least` times of what is compared.
    """

    rounds: int = 10
    warm_up: int = 1
    stolen: float = 0.1
    confidence: float = 0.95
    processor: int | None = None
    least: int = 10

    def __post_init__(self) -> None:
        if self.rounds < LEAST_ROUNDS:
            raise SpecError(f"rounds={self.rounds} are too few for an interval: give at least {LEAST_ROUNDS}.")
        if self.warm_up < 0 or self.least < 1:
            raise SpecError("warm_up is 0 or more, and least is 1 or more.")
        if not 0.5 <= self.confidence < 1:
            raise SpecError(f"confidence={self.confidence} is no confidence: give 0.5 to below 1, such as 0.95.")
        if not 0 < self.stolen <= 1:
            raise SpecError(f"stolen={self.stolen} is no share: give more than 0, up to 1, such as 0.1.")


@dataclass(frozen=True)
class Round:
    """What each measure gave, once, one after the other.

    `lost` is the part of the time (0 to 1) lost in the worst, `lasted` how long (ns) all took.
    """

    blocks: Sequence[Block]
    lost: float
    lasted: int = 0


@dataclass(frozen=True)
class Rounds:
    """Rounds that count, and how many were set aside."""

    kept: Sequence[Round]
    set_aside: int = 0
    most_lost: float = 0.0

    def said(self) -> str:
        """Return a sentence on them."""
        aside = f"; {self.set_aside} were set aside, in which others had the processor" if self.set_aside else ""
        return f"{len(self.kept)} rounds, interleaved{aside}."


def interleaved(measures: Sequence[Measure], rules: Rules, tell: Tell = lambda line: None) -> Rounds:
    """Measure each of them in every round, forwards and backwards in turn, on one processor.

    Raises `UndecidedError` where the machine was so busy that too few rounds are left.
    """
    return sifted(taken(measures, rules, rules.rounds, tell), rules)


def taken(measures: Sequence[Measure], rules: Rules, rounds: int, tell: Tell = lambda line: None) -> list[Round]:
    """Return so many rounds, after those that warm up."""
    found, all_rounds = list[Round](), rules.warm_up + rounds
    with bound_to(rules.processor) as processor:
        for number in range(-rules.warm_up, rounds):
            found.append(_round(measures, processor, backwards=number > 0 and number % 2 == 1))
            tell(f"round {len(found)} of {all_rounds} took {describe(found[-1].lasted)}")
    return found[rules.warm_up :]


def sifted(rounds: Sequence[Round], rules: Rules) -> Rounds:
    """Return the rounds that count; raise `UndecidedError` where they are too few."""
    kept = [each for each in rounds if each.lost <= rules.stolen]
    lost = max(each.lost for each in rounds)
    if len(kept) < LEAST_ROUNDS:
        raise UndecidedError(
            f"the machine was too busy to measure: in {len(rounds) - len(kept)} of {len(rounds)} rounds others had "
            f"the processor for more than {rules.stolen:.0%} of the time, up to {lost:.0%}. Measure on a quieter "
            "machine, with more rounds, or with a larger share for others (stolen=…)."
        )
    return Rounds(kept, len(rounds) - len(kept), lost)


def _round(measures: Sequence[Measure], processor: int | None, *, backwards: bool) -> Round:
    blocks: dict[int, Block] = {}
    found: list[Disturbance] = []
    for number in reversed(range(len(measures))) if backwards else range(len(measures)):
        with watched(processor, measures[number].schedstat) as disturbance:
            blocks[number] = measures[number].run()
        found.append(disturbance)
    in_order = [blocks[number] for number in range(len(measures))]
    return Round(in_order, max(each.share for each in found), sum(each.lasted for each in found))


def once(measures: Sequence[Measure]) -> Rounds:
    """Measure each once: enough where every run is the same to the byte."""
    return Rounds([Round([measure.run() for measure in measures], 0.0)])


def of_subject(subject: Subject) -> Measure:
    """Return what runs a subject and gives its times."""
    return Measure(lambda: block_of(subject.run()))


def block_of(result: Result) -> Block:
    """Return the times of a result: ages by device, and under `LEARNING` what a transition took in the mean."""
    times = {name: values for name, values in times_of(result).items() if name != AGE}
    return {**times, **ages_of(result), LEARNING: learning_of(result)}


def floor() -> Block:
    """Measure how late (ns) this machine wakes an event loop that does nothing else."""
    return {FLOOR: clock.run(sleeps(FLOOR_LASTS), "real")}
