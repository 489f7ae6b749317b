"""What the thesis says of Experiment 2, beside what was found, with verdicts that follow from intervals."""

from __future__ import annotations

import numpy as np

from rtagent.experiments.egg.conditions import NAMES, REACTIVE_SARSA, SARSA
from rtagent.experiments.egg.people import Group, Times, from_control, percent, rate, times_as_many, trailing
from rtagent.experiments.egg.variants import PRACTISED
from rtagent.experiments.experiment import Claim, Verdict
from rtagent.experiments.statistics import Interval, above, below, within

THEIRS_TIMES = 4.0
NEAR = 0.5
"""Nearer to control than to SARSA is near."""

ABOUT = (0.75, 1.25)
"""Of the learning delay: about as long."""

DELAY = 0.05
"""The learning delay of the scenario, in s."""

FOUR = 4
"""So many people took part in the thesis's experiment."""

DRAWN = 500
MOSTLY = 0.95


def claims(group: Group) -> list[Claim]:
    """Return the thesis's claims beside what the people of the main variant did."""
    return [more_failures(group), fewer_for_all(group), near_control(group), trails(group), *overlaps(group)]


def more_failures(group: Group) -> Claim:
    """Say whether SARSA has more than four times the failed stops of reactive SARSA."""
    found = times_as_many(group)
    rates = ", ".join(f"{name} {percent(rate(group, condition))} %" for condition, name in NAMES.items())
    four = of_four(group)
    return Claim(
        "SARSA has more than four times as many failed stops as reactive SARSA (figure 3.5).",
        "more than 4 times, of 80 stops each by four people",
        f"{found} times (failed: {rates}); of groups of four people {four:.0%} have more than 4 times",
        _of_times(found),
        "Both follow from where people aim; the thesis tells no speed, distance or margin: see the variants.",
    )


def fewer_for_all(group: Group) -> Claim:
    """Say whether each of four people has fewer failed stops with reactive SARSA."""
    standard, reactive = (group.rates(name) for name in (SARSA, REACTIVE_SARSA))
    groups = _fours(len(group.people))
    share = float(np.mean((reactive[groups] < standard[groups]).all(1)))
    fewer, alike = float(np.mean(reactive < standard)), float(np.mean(reactive == standard))
    return Claim(
        "All four people had fewer failed stops with reactive SARSA than with SARSA (figure 3.5).",
        "far fewer, for all four",
        f"so in {share:.0%} of groups of four; of all people {fewer:.0%} had fewer, and {alike:.0%} as many",
        mostly(share),
        "Who crushes no egg with either has as many.",
    )


def near_control(group: Group) -> Claim:
    """Say whether reactive SARSA is nearer to control than half of SARSA's distance."""
    found = from_control(group)
    return Claim(
        "Reactive SARSA's failed stops are near those of control: nearer than half of SARSA's (figure 3.5).",
        "no number is stated",
        f"they are {found} times as far from control's as SARSA's are; from those in control's last {PRACTISED} "
        f"episodes, when people have practised, {from_control(group, PRACTISED)} times",
        below(found, NEAR),
        "Control acts as the reactive order does, delay included: between them is what people learn meanwhile.",
    )


def trails(group: Group) -> Claim:
    """Say whether SARSA acts about a learning delay later than reactive SARSA."""
    found = trailing(group, DELAY)
    medians = {name: 1e3 * float(np.median(group.gaps(name))) for name in (SARSA, REACTIVE_SARSA)}
    return Claim(
        "SARSA's stop trails the press by about the length of the learning update and delay (figure 3.6).",
        "about 50 ms, by its words",
        f"{found} delays later than reactive SARSA; after the press: SARSA {medians[SARSA]:.0f} ms, "
        f"reactive SARSA {medians[REACTIVE_SARSA]:.0f} ms (medians)",
        within(found, *ABOUT),
        "A press falls anywhere in a learning step, which adds half a step to both before it is seen.",
    )


def overlaps(group: Group) -> list[Claim]:
    """Say whether the boxes of presses and actions overlap with reactive SARSA, and are apart with SARSA."""
    reactive, standard = (parted(group, name) for name in (REACTIVE_SARSA, SARSA))
    return [
        Claim(
            "The boxes of presses and of reactive SARSA's actions overlap (figure 3.6).",
            "a tight overlap",
            f"they overlap in {1 - reactive:.0%} of groups of four people",
            mostly(1 - reactive),
        ),
        Claim(
            "Between the boxes of presses and of SARSA's actions there is a gap (figure 3.6).",
            "a visible gap",
            f"there is one in {standard:.0%} of groups of four people",
            mostly(standard),
            "How wide the boxes are depends on how differently people time their presses, and on what they learn.",
        ),
    ]


def of_four(group: Group) -> float:
    """Return which part of groups of four people have more than four times as many failed stops with SARSA."""
    standard, reactive = (group.rates(name) for name in (SARSA, REACTIVE_SARSA))
    groups = _fours(len(group.people))
    more = standard[groups].sum(1) > THEIRS_TIMES * reactive[groups].sum(1)
    return float(np.mean(more))


def parted(group: Group, condition: str) -> float:
    """Return in which part of groups of four people the box of actions begins after that of presses has ended."""
    pressed, acted = (_by_person(group, condition, event) for event in ("pressed", "acted"))
    ends = [np.quantile(np.concatenate([pressed[each] for each in four]), 0.75) for four in _fours(len(pressed))]
    begins = [np.quantile(np.concatenate([acted[each] for each in four]), 0.25) for four in _fours(len(acted))]
    return float(np.mean(np.array(begins) > np.array(ends)))


def _by_person(group: Group, condition: str, event: str) -> list[Times]:
    return [group.times(condition, event, [place]) for place in range(len(group.people))]


def _fours(people: int) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """Return groups of four people by their places, the same whenever asked for."""
    rng = np.random.default_rng(0)
    return np.array([rng.permutation(people)[:FOUR] for _ in range(DRAWN)])


def _of_times(found: Interval) -> Verdict:
    """Say whether it is more than the thesis's number; where it is fewer, but more than once, that differs."""
    verdict = above(found, THEIRS_TIMES)
    fewer = verdict is Verdict.NOT_REPRODUCED and above(found, 1.0) is Verdict.REPRODUCED
    return Verdict.DIFFERS if fewer else verdict


def mostly(share: float) -> Verdict:
    """Say whether something is so in nearly all groups, or in nearly none."""
    if share >= MOSTLY:
        return Verdict.REPRODUCED
    return Verdict.NOT_REPRODUCED if share <= 1 - MOSTLY else Verdict.UNDECIDED
