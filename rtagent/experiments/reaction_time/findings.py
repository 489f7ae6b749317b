"""What Experiment 1 found: its claims, each from intervals over trials, and what is drawn of it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rtagent.experiments.experiment import Cell, Claim, Findings, Options, Row, Verdict
from rtagent.experiments.reaction_time.figures import figures
from rtagent.experiments.reaction_time.groups import Groups, alike, delays, groups_of, median, reward, values
from rtagent.experiments.reaction_time.tables import literal_table, table
from rtagent.experiments.reaction_time.trials import Trial
from rtagent.experiments.statistics import (
    Interval,
    above,
    all_of,
    below,
    compared,
    interval,
    paired,
    pooled,
    within,
)

STANDARD, REACTIVE, INTERRUPTIBLE = "standard", "reactive", "interruptible"
HALF, ONE, FLAT = (0.4, 0.6), (0.8, 1.2), 0.02
"""What "about half" of a delay and "a full timestep" may be; and by which part of it what is flat may grow."""

LEAST = 1e-12
"""A deviation of 0 would have no logarithm."""

WHY_NOT_MORE_VARIABLE = (
    "Emergency begins anywhere within a step of learning, for both orders alike: it moves either reaction by at "
    "most one delay, and a wait that is longer by the same each time does not vary more."
)
DEMONS_NOTE = (
    "The thesis equates delays of 50, 100, 250 and 500 ms with about 15,000, 45,000, 75,000 and 150,000 demons. At "
    "its own 3.33 µs a demon they are 15,000, 30,000, 75,000 and 150,000: the second is a slip."
)


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Compare the schedules, at each delay and over all of them."""
    literal = [(cell, row) for cell, row in pairs if "reward_unit" in cell]
    pairs = [(cell, row) for cell, row in pairs if "reward_unit" not in cell]
    groups = groups_of(pairs)
    made = (half_the_delay, a_timestep_more, quicker, falling, less_severe, more_variable, flat)
    claims = tuple(claim for make in made for claim in make(groups))
    further = (literal_table(literal),) if literal else ()
    return Findings(claims, figures(groups, pairs), (table(groups), *further), (DEMONS_NOTE,))


def half_the_delay(groups: Groups) -> Iterator[Claim]:
    """Claim: the median reaction of the reactive order is about half the delay."""
    found = {
        delay: _scaled(interval(values(groups[REACTIVE, delay], median), np.median), delay)
        for delay in delays(groups, above=0)
    }
    overall = interval(_parts_of_delay(groups))
    yield Claim(
        "The median reaction time of Reactive SARSA is about half of the added learning delay.",
        "approximately 0.5 of the delay",
        f"{overall} over all delays; {_each(found)}",
        within(overall, *HALF),
    )


def _parts_of_delay(groups: Groups) -> list[float]:
    """Return, for each seed, which part of the delay the median reaction is, in the mean over the delays."""
    parts: dict[int, list[float]] = defaultdict(list)
    for delay in delays(groups, above=0):
        for trial in groups[REACTIVE, delay]:
            parts[trial["seed"]] += [found / delay for found in values([trial], median)]
    return [float(np.mean(found)) for found in parts.values() if found]


def a_timestep_more(groups: Groups) -> Iterator[Claim]:
    """Claim: the standard order waits for a full timestep more."""
    found = {
        delay: _scaled(_later(groups[STANDARD, delay], groups[REACTIVE, delay]), delay)
        for delay in delays(groups, above=0)
    }
    yield Claim(
        "Standard SARSA must wait a full additional timestep before it reacts.",
        "1 delay more than Reactive SARSA",
        _each(found),
        all_of(within(each, *ONE) for each in found.values()),
    )


def quicker(groups: Groups) -> Iterator[Claim]:
    """Claim: the reactive order reacts sooner at every delay, 0 included."""
    found = {delay: _later(groups[STANDARD, delay], groups[REACTIVE, delay]) for delay in delays(groups)}
    yield Claim(
        "Reactive SARSA reacts significantly sooner than SARSA at all delays.",
        "for all 5 delays",
        f"median sooner, in ms, by {_each(found)}",
        all_of(map(above, found.values())),
    )


def falling(groups: Groups) -> Iterator[Claim]:
    """Claim: the more learning takes, the less reward both orders get."""
    for schedule in (STANDARD, REACTIVE):
        steps = {
            later: paired(*alike(groups[schedule, later], groups[schedule, sooner], reward))
            for sooner, later in pairwise(delays(groups))
        }
        means = ", ".join(f"{np.mean(values(groups[schedule, delay], reward)):.3g}" for delay in delays(groups))
        yield Claim(
            f"As the delay increases, the reward of {schedule} SARSA decreases.",
            "decreases, delay by delay (figure 3.4)",
            f"{means}; changes {_each(steps)}",
            all_of(map(below, steps.values())),
        )


def less_severe(groups: Groups) -> Iterator[Claim]:
    """Claim: the delay costs the reactive order less than the standard one."""
    first, last = delays(groups)[0], delays(groups)[-1]
    lost = {
        schedule: list(np.subtract(*alike(groups[schedule, first], groups[schedule, last], reward)))
        for schedule in (STANDARD, REACTIVE)
    }
    ratio = compared(lost[REACTIVE], lost[STANDARD], _ratio)
    yield Claim(
        "SARSA performs worse; the impact of the delay on Reactive SARSA is less severe.",
        "less severe",
        f"from {first:g} to {last:g} ms it loses {ratio} of what standard SARSA loses",
        below(ratio, 1.0),
    )


def more_variable(groups: Groups) -> Iterator[Claim]:
    """Claim: the summed reward of the standard order varies more."""
    over = delays(groups, above=0)
    ratios = {
        delay: compared(
            values(groups[STANDARD, delay], reward), values(groups[REACTIVE, delay], reward), _ratio, _deviation
        )
        for delay in over
    }
    all_delays = pooled(
        [(values(groups[STANDARD, delay], reward), values(groups[REACTIVE, delay], reward)) for delay in over],
        _log_ratio,
    )
    ratio = Interval(*(float(np.exp(each)) for each in (all_delays.low, all_delays.middle, all_delays.high)))
    verdict = above(ratio, 1.0)
    yield Claim(
        "SARSA performs with larger variability.",
        "larger variability of the summed reward",
        f"standard deviation {ratio} times that of Reactive SARSA over all delays; {_each(ratios)}",
        verdict,
        "" if verdict is Verdict.REPRODUCED else WHY_NOT_MORE_VARIABLE,
    )


def flat(groups: Groups) -> Iterator[Claim]:
    """Claim, of the thesis's future work: learning that can be interrupted need not delay a reaction."""
    if (INTERRUPTIBLE, delays(groups)[0]) not in groups:
        return
    first, last = delays(groups)[0], delays(groups)[-1]
    share = _scaled(_later(groups[INTERRUPTIBLE, last], groups[INTERRUPTIBLE, first]), last - first)
    yield Claim(
        "To interrupt learning for more pressing computations is a subject of future work (3.5). Here: reactions "
        "of the schedule interruptible do not depend on the delay.",
        "not tried",
        f"from {first:g} to {last:g} ms of delay the median reaction grows by {share} of it",
        within(share, -FLAT, FLAT),
    )


def _later(ours: Sequence[Trial], others: Sequence[Trial]) -> Interval:
    """Return by how much (ms) the median reaction of one group is later than that of the other, seed by seed."""
    return paired(*alike(ours, others, median), np.median)


def _ratio(ours: float, others: float) -> float:
    return ours / others if others else np.inf


def _log_ratio(ours: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    return float(np.log(max(_deviation(ours), LEAST) / max(_deviation(others), LEAST)))


def _deviation(values: NDArray[np.float64]) -> np.float64:
    return np.std(values, ddof=1, dtype=np.float64)


def _scaled(found: Interval, unit: float) -> Interval:
    return Interval(found.low / unit, found.middle / unit, found.high / unit)


def _each(found: dict[float, Interval]) -> str:
    return "; ".join(f"{each} at {delay:g} ms" for delay, each in found.items())
