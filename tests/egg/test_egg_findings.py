"""What is found in attempts that were made up by hand: numbers, and verdicts that turn where the data do."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from rtagent.experiments.egg import EXPERIMENT
from rtagent.experiments.egg.claims import claims, mostly
from rtagent.experiments.egg.conditions import CONTROL, REACTIVE_SARSA, SARSA
from rtagent.experiments.egg.findings import find
from rtagent.experiments.egg.people import Group, from_control, grouped, rate, times_as_many, trailing
from rtagent.experiments.egg.variants import VARIANTS, alone
from rtagent.experiments.experiment import Claim, Options, Verdict

GAPS = {CONTROL: 0.025, REACTIVE_SARSA: 0.025, SARSA: 0.075}
EPISODES = {CONTROL: 10, REACTIVE_SARSA: 20, SARSA: 20}
PEOPLE = 12


def attempt(condition: str, number: int, broken: int, gap: float) -> Mapping[str, Any]:
    pressed = 0.8 + 0.01 * (number % 10)
    return {
        "condition": condition,
        "pressed": pressed,
        "acted": pressed + gap,
        "short": -0.1 if number < broken else 0.1,
        "broken": number < broken,
    }


def person(broken: Mapping[str, int], gaps: Mapping[str, float] = GAPS) -> Mapping[str, Any]:
    return {
        "spread_ms": 30.0,
        "attempts": [
            attempt(condition, number, broken[condition], gaps[condition])
            for condition in broken
            for number in range(EPISODES.get(condition, 20))
        ],
    }


def group(broken: Mapping[str, int], gaps: Mapping[str, float] = GAPS, people: int = PEOPLE) -> Group:
    return Group([person(broken, gaps)] * people)


USUAL = {CONTROL: 1, SARSA: 12, REACTIVE_SARSA: 2}
OTHERWISE = {CONTROL: 1, SARSA: 2, REACTIVE_SARSA: 12}


def verdicts(found: Sequence[Claim]) -> list[Verdict]:
    return [claim.verdict for claim in found]


def test_rates_and_ratios_by_hand() -> None:
    """12 of 20 against 2 of 20 is 6 times; control's 10 % is as far from reactive's 10 % as 0 from SARSA's 60 %."""
    usual = group(USUAL)
    assert (rate(usual, SARSA).middle, rate(usual, REACTIVE_SARSA).middle) == pytest.approx((0.6, 0.1))
    assert times_as_many(usual).middle == pytest.approx(6.0)
    assert from_control(usual).middle == pytest.approx(0.0)
    assert trailing(usual, 0.05).middle == pytest.approx(1.0)
    assert usual.gaps(SARSA) == pytest.approx([0.075] * PEOPLE)
    assert usual.shorts(SARSA) == pytest.approx([0.1] * PEOPLE)


def test_an_interval_is_over_people_with_all_their_episodes() -> None:
    """Half the people break all eggs, and half none: the rate is one half, and very uncertain."""
    people = [person({**USUAL, SARSA: broken}) for broken in (0, 20)] * 4
    found = rate(Group(people), SARSA)
    assert found.middle == pytest.approx(0.5)
    assert found.high - found.low > 0.4


def test_only_the_last_of_a_condition_are_counted_where_that_is_asked() -> None:
    """The first one broke, of ten."""
    usual = group(USUAL)
    assert (rate(usual, CONTROL).middle, rate(usual, CONTROL, 5).middle) == pytest.approx((0.1, 0.0))
    assert from_control(usual, 5).middle == pytest.approx(0.1 / 0.6)


def test_where_no_egg_breaks_half_a_one_is_divided_by() -> None:
    """12 × 12 against one half."""
    found = times_as_many(group({**USUAL, REACTIVE_SARSA: 0}))
    assert found.middle == pytest.approx(12 * PEOPLE / 0.5)


def test_the_thesis_is_found_again_in_data_that_say_so() -> None:
    assert verdicts(claims(group(USUAL))) == [Verdict.REPRODUCED] * 6


def test_other_data_give_other_verdicts() -> None:
    """The two algorithms changed round, in failures and in times."""
    swapped = {CONTROL: 0.025, SARSA: 0.025, REACTIVE_SARSA: 0.075}
    assert verdicts(claims(group(OTHERWISE, swapped))) == [Verdict.NOT_REPRODUCED] * 6


@pytest.mark.parametrize(
    ("broken", "verdict"),
    [(9, Verdict.REPRODUCED), (8, Verdict.DIFFERS), (6, Verdict.DIFFERS), (1, Verdict.NOT_REPRODUCED)],
)
def test_four_times_as_many_is_the_line(broken: int, verdict: Verdict) -> None:
    """Of 20, against 2: 4.5, 4, 3 and half as many."""
    assert claims(group({**USUAL, SARSA: broken}))[0].verdict is verdict


def test_where_people_differ_much_four_times_is_undecided() -> None:
    """Half of them break 2 of 20, and half 16: 9 against 2 on average, and it might be fewer."""
    people = [person({**USUAL, SARSA: broken}) for broken in (2, 16)] * (PEOPLE // 2)
    assert claims(Group(people))[0].verdict is Verdict.UNDECIDED


def test_one_person_in_six_who_crushes_as_many_is_in_half_of_the_groups() -> None:
    """Two of twelve: 1 - (10 · 9 · 8 · 7) / (12 · 11 · 10 · 9) = 58 % of groups of four have one of them."""
    people = [person(USUAL)] * 10 + [person({**USUAL, SARSA: 2})] * 2
    found = claims(Group(people))[1]
    (share,) = re.findall(r"so in (\d+)%", found.ours)
    assert int(share) == pytest.approx(42, abs=6)
    assert found.verdict is Verdict.UNDECIDED


def test_most_groups_of_four_decide() -> None:
    assert [mostly(share) for share in (0.96, 0.5, 0.04)] == [
        Verdict.REPRODUCED,
        Verdict.UNDECIDED,
        Verdict.NOT_REPRODUCED,
    ]


def pairs_of(people: int = 4) -> list[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """Return made-up rows for all variants, in batches of two."""
    rows = []
    for name, variant in VARIANTS.items():
        broken = USUAL if len(variant.mixed) > 1 else {variant.mixed[0]: 5}
        one = person(broken, dict.fromkeys(broken, 0.05) | GAPS)
        rows += [({"variant": name}, {"people": [one, one]})] * (people // 2)
    return rows


def test_people_of_all_cells_of_a_variant_are_one_group() -> None:
    assert {name: len(each.people) for name, each in grouped(pairs_of()).items()} == dict.fromkeys(VARIANTS, 4)


@pytest.mark.slow
def test_everything_found_can_be_drawn_and_told() -> None:
    canvas_of = pytest.importorskip("matplotlib.figure").Figure
    found = find(pairs_of(), Options())
    assert len(found.claims) == 6
    for figure in found.figures:
        canvas = canvas_of(figsize=figure.size)
        figure.draw(canvas)
        assert canvas.axes[0].get_ylabel().endswith((")", "%)"))
        assert "4" in figure.caption
    first, second = found.tables
    assert [row[0] for row in (*first.rows, *second.rows)] == [
        name if not name.endswith("alone") else name.removesuffix(" alone") for name in VARIANTS
    ]
    assert all(len(row) == len(table.head) for table in found.tables for row in table.rows)


def test_findings_are_made_of_what_is_there() -> None:
    """One variant of many, as from a sweep that was stopped."""
    only = [pair for pair in pairs_of() if pair[0]["variant"] == alone("standard")]
    found = find(only, Options())
    assert not found.claims
    assert [figure.name for figure in found.figures] == ["schedules"]
    assert find([], Options()).figures == ()


def test_the_experiment_tells_its_time_and_what_it_models() -> None:
    cells = EXPERIMENT.cells(Options(quick=True))
    assert 5 < sum(EXPERIMENT.seconds(each) for each in cells) < 120
    assert any("model" in sentence for sentence in EXPERIMENT.models)
    assert np.isfinite([EXPERIMENT.seconds(each) for each in cells]).all()
