"""The style of figures can be told apart in grey; the statistics behind verdicts are what they are called."""

from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy import stats

from rtagent.errors import ScenarioError
from rtagent.experiments import style
from rtagent.experiments.experiment import Verdict
from rtagent.experiments.scenarios import names, run_scenario, scenario
from rtagent.experiments.statistics import (
    Interval,
    _student,
    above,
    all_of,
    below,
    compared,
    interval,
    paired,
    pooled,
    within,
)

REPRODUCED, NOT, UNDECIDED = Verdict.REPRODUCED, Verdict.NOT_REPRODUCED, Verdict.UNDECIDED


def lightness(color: str) -> float:
    """Return L* of a colour (CIE 1976), which is what of it is left in grey."""
    parts = [int(color[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    y = float(np.dot(linear, (0.2126, 0.7152, 0.0722)))
    return 116 * np.cbrt(y) - 16 if y > 0.008856 else 903.3 * y


def test_ten_series_stay_apart_without_colour() -> None:
    assert len(style.LINES) == 10
    for first, second in combinations(style.LINES, 2):
        assert first.marker != second.marker
        assert first.hatch != second.hatch
    assert len({str(line.linestyle) for line in style.LINES}) >= 9
    for before, after in pairwise(style.LINES[:5]):
        assert abs(lightness(before.color) - lightness(after.color)) > 10
    assert all(lightness(line.color) < 80 for line in style.LINES), "all are seen on paper"


def test_series_and_boxes_are_drawn_with_what_they_are_given(tmp_path: Path) -> None:
    canvas = Figure()
    axes = canvas.add_subplot()
    style.series(axes, 1, [1, 2], [3, 4], "line", low=[2, 3], high=[4, 5])
    style.boxes(axes, 2, [[1.0, 2.0, 3.0], [4.0, 5.0]], [1, 2], "box")
    assert axes.get_legend_handles_labels()[1] == ["line", "box"]
    assert axes.lines[0].get_marker() == style.LINES[1].marker
    assert [box.get_hatch() for box in axes.patches[:2]] == [style.LINES[2].hatch] * 2
    for file in style.save(canvas, tmp_path / "figure"):
        assert file.stat().st_size > 1000


def test_scenarios_are_found_and_run() -> None:
    assert "stopping" in names()
    assert scenario("stopping").name == "stopping.toml"
    result = run_scenario("stopping", ["run.clock=virtual", "run.episodes=2"])
    assert len(result.episodes) == 2
    with pytest.raises(ScenarioError, match="no scenario 'stoping' in this installation: did you mean 'stopping'"):
        scenario("stoping")


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (0.41, 0.59, REPRODUCED),
        (0.4, 0.6, REPRODUCED),
        (0.3, 0.5, UNDECIDED),
        (0.1, 0.3, NOT),
        (0.61, 2, NOT),
        (0, 1, UNDECIDED),
    ],
)
def test_a_verdict_asks_whether_the_interval_is_within(low: float, high: float, verdict: Verdict) -> None:
    assert within(Interval(low, (low + high) / 2, high), 0.4, 0.6) == verdict


@pytest.mark.parametrize(
    ("low", "high", "verdict"), [(0.1, 1, REPRODUCED), (0, 1, UNDECIDED), (-1, 0, NOT), (-1, 1, UNDECIDED)]
)
def test_above_and_below_are_strict_and_mirror_each_other(low: float, high: float, verdict: Verdict) -> None:
    assert above(Interval(low, 0.5, high)) == verdict
    assert below(Interval(-high, -0.5, -low)) == verdict


def test_a_claim_of_several_parts_is_reproduced_where_all_are() -> None:
    assert all_of([REPRODUCED, REPRODUCED]) == REPRODUCED
    assert all_of([REPRODUCED, UNDECIDED]) == UNDECIDED
    assert all_of([REPRODUCED, Verdict.DIFFERS]) == Verdict.DIFFERS
    assert all_of([UNDECIDED, NOT, REPRODUCED]) == NOT


@pytest.mark.parametrize("seeds", [3, 5, 10, 40])
def test_an_interval_of_a_mean_holds_it_nineteen_times_of_twenty(seeds: int) -> None:
    samples = np.random.default_rng(seeds).normal(5.0, 2.0, (300, seeds))
    inside = sum(found.low <= 5.0 <= found.high for found in map(interval, samples))
    assert 0.92 < inside / 300 < 0.98


def test_an_interval_of_many_seeds_is_as_wide_as_theory_says() -> None:
    samples = np.random.default_rng(1).normal(5.0, 2.0, (50, 60))
    width = np.mean([found.high - found.low for found in map(interval, samples)])
    assert width == pytest.approx(2 * stats.t.ppf(0.975, 59) * 2.0 / np.sqrt(60), rel=0.05)


@pytest.mark.parametrize("freedom", [1, 2, 5, 9, 10, 15, 30, 200])
def test_the_quantiles_of_student_are_right(freedom: int) -> None:
    assert _student(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=2e-3)


def test_of_one_seed_nothing_follows() -> None:
    alone = interval([0.5])
    assert (alone.low, alone.middle, alone.high) == (-np.inf, 0.5, np.inf)
    assert (
        within(alone, 0.4, 0.6)
        == above(alone, 0.0)
        == below(compared([1.0], [2.0], lambda a, b: a - b))
        == UNDECIDED
    )


def test_pairs_that_share_their_worlds_are_compared_world_by_world() -> None:
    rng = np.random.default_rng(2)
    worlds = rng.normal(0, 10, 30)
    ours = worlds + 1 + rng.normal(0, 0.1, 30)
    together = paired(list(ours), list(worlds))
    apart = compared(list(ours), list(worlds), lambda a, b: a - b)
    assert 0.9 < together.low < together.high < 1.1
    assert apart.low < 0 < apart.high


def test_pooling_narrows_the_interval() -> None:
    rng = np.random.default_rng(3)
    groups = [(list(rng.normal(1, 1, 20)), list(rng.normal(0, 1, 20))) for _ in range(9)]

    def difference(a: np.ndarray, b: np.ndarray) -> float:
        return float(a.mean() - b.mean())

    all_of_them, one = pooled(groups, difference), pooled(groups[:1], difference)
    assert (all_of_them.high - all_of_them.low) * 2 < one.high - one.low
    assert all_of_them.low < 1 < all_of_them.high
