"""What the thesis claims of multimodal predictions (sections 5.3 and 5.4), beside what was found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

from rtagent.experiments.experiment import Claim, Verdict
from rtagent.experiments.grasping import FINGERS, SETTINGS
from rtagent.experiments.multimodal.errors import ALL, OTHERS, Errors, diverged, effect, ratio
from rtagent.experiments.statistics import Interval, above, all_of, below, within

SMALL = 0.2
"""Cohen's least effect that is called small (Cohen, 1988)."""
NEARLY = (0.9, 1.1)
"""Medians whose ratio lies in between are called nearly the same."""
COLOR, POSITION = OTHERS
RING = (
    "here neither colour nor position alone tells of ring, which is put down for half of what either shows, and "
    "both together do; why that did not show in the thesis's recording its text does not say"
)


def claims_of(errors: Errors, reading: str) -> list[Claim]:
    """Return the claims, for one reading of α = 0.01."""
    if lost := diverged(errors):
        ours = f"diverged with {', '.join(lost)}"
        return [Claim(f"Learning works with α = 0.01 read as {reading}", "it does", ours, Verdict.NOT_REPRODUCED)]
    return [
        _better(errors, reading, 0.0),
        _better(errors, reading, SMALL),
        _ring_effects(errors, reading),
        _ring_median(errors, reading),
        *(_narrower(errors, finger, reading) for finger in FINGERS),
        _middle_narrowest(errors, reading),
        _before(errors, reading),
        _during(errors, reading),
    ]


def _better(errors: Errors, reading: str, least: float) -> Claim:
    by = f" by at least a small effect, d = {least}," if least else ""
    return _claim(
        f"“All” predicts middle and pinky better{by} than each kind of sensors alone (α = 0.01 as {reading})",
        "better, with a small to medium effect (Cohen's d) against both (figure 5.9)",
        {
            f"{finger} against “{other}”": effect(errors, finger, other)
            for finger in ("middle", "pinky")
            for other in OTHERS
        },
        "d = {}",
        partial(at_least, least=least),
    )


def _ring_effects(errors: Errors, reading: str) -> Claim:
    color, position = (effect(errors, "ring", other) for other in OTHERS)
    verdict = all_of([at_least(color, SMALL), below(position, SMALL)])
    return Claim(
        f"For ring “All” is better by such an effect than “{COLOR}”, not than “{POSITION}” (α = 0.01 as {reading})",
        f"a small to medium effect, with the exception of ring on “{POSITION}” (figure 5.9)",
        f"d = {color} against “{COLOR}”, {position} against “{POSITION}”",
        verdict,
        "" if verdict == Verdict.REPRODUCED else RING,
    )


def _ring_median(errors: Errors, reading: str) -> Claim:
    return _claim(
        f"The median of ring's errors is nearly the same with “All” and “{POSITION}” (α = 0.01 as {reading})",
        "almost identical (figure 5.8)",
        {f"“All” against “{POSITION}”": ratio(errors, "median", (ALL, "ring"), (POSITION, "ring"))},
        "{} times",
        partial(within, low=NEARLY[0], high=NEARLY[1]),
        RING,
    )


def _narrower(errors: Errors, finger: str, reading: str) -> Claim:
    slightly = "slightly smaller" if finger == "ring" else "smaller"
    return _claim(
        f"The variance of {finger}'s errors is smaller with “All” (α = 0.01 as {reading})",
        f"smaller than with “{COLOR}”, {slightly} than with “{POSITION}” (figure 5.8)",
        {f"against “{other}”": ratio(errors, "variance", (ALL, finger), (other, finger)) for other in OTHERS},
        "{} times",
        partial(below, bound=1.0),
    )


def _middle_narrowest(errors: Errors, reading: str) -> Claim:
    return _claim(
        f"With every setting the variance of errors is least for middle (α = 0.01 as {reading})",
        "lower than for ring and pinky across all input settings (figure 5.8)",
        {
            f"{finger} with “{setting}”": ratio(errors, "variance", (setting, "middle"), (setting, finger))
            for setting in SETTINGS
            for finger in ("ring", "pinky")
        },
        "{} times",
        partial(below, bound=1.0),
    )


def _before(errors: Errors, reading: str) -> Claim:
    return _claim(
        f"Before the grasp “{POSITION}”, without colour, errs more for ring and pinky (α = 0.01 as {reading})",
        "a large offset before the onset, which “All” does not have (figure 5.7)",
        {finger: ratio(errors, "before", (POSITION, finger), (ALL, finger)) for finger in ("ring", "pinky")},
        "{} times the error of “All”",
        partial(above, bound=1.0),
        "before the grasp only colour is seen, which tells nothing of ring: it is put down for 31 of 64 green and "
        "33 of 67 orange objects; shapes that cover different parts of the picture could tell",
    )


def _during(errors: Errors, reading: str) -> Claim:
    return _claim(
        f"During the grasp “{COLOR}” errs more than “All” for each finger (α = 0.01 as {reading})",
        "not able to accurately predict any of the potentiometer values (figure 5.7)",
        {finger: ratio(errors, "during", (COLOR, finger), (ALL, finger)) for finger in FINGERS},
        "{} times the error of “All”",
        partial(above, bound=1.0),
    )


def _claim(
    said: str,
    theirs: str,
    found: Mapping[str, Interval],
    told: str,
    side: Callable[[Interval], Verdict],
    why: str = "",
) -> Claim:
    """Return a claim that is one about each of what was found; `why` is told where not all are reproduced."""
    verdicts = {name: side(each) for name, each in found.items()}
    ours = "; ".join(f"{name}: {told.format(each)}" for name, each in found.items())
    other = [f"{name} ({verdict})" for name, verdict in verdicts.items() if verdict != Verdict.REPRODUCED]
    parts = [f"in part: {', '.join(other)}" if 0 < len(other) < len(found) else "", why if other else ""]
    return Claim(said, theirs, ours, all_of(verdicts.values()), "; ".join(filter(None, parts)))


def at_least(found: Interval, least: float) -> Verdict:
    """Say whether an effect is surely so large; it differs where there surely is one, and surely a smaller one."""
    if found.low > 0.0 and found.high < least:
        return Verdict.DIFFERS
    verdict = above(found, least)
    return Verdict.UNDECIDED if verdict == Verdict.NOT_REPRODUCED and found.high > 0.0 else verdict
