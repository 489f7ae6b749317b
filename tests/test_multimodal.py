"""What is found in errors of multimodal predictions: verdicts follow from the rows, and turn with them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from rtagent.experiments import statistics
from rtagent.experiments.experiment import Cell, Claim, Findings, Options, Row, Verdict
from rtagent.experiments.grasping import FINGERS, SETTINGS, inputs
from rtagent.experiments.multimodal import EXPERIMENT
from rtagent.experiments.multimodal.errors import effect, ratio
from rtagent.experiments.multimodal.testing import Test as OfPredictions
from rtagent.experiments.streams import Stream, seen_ranges

LINE = {"time": [0.0, 1.0], "signal": [0.0, 1.0], "prediction": [0.0, 0.5], "return": [0.5, 1.0]}
SEEDS = 6
USUAL = {"Color only": 0.10, "Position only": 0.10, "All": 0.07}
FLIPPED = {"Color only": 0.07, "Position only": 0.07, "All": 0.10}


@pytest.fixture(autouse=True)
def _fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw fewer bootstrap samples: intervals need not be exact here."""
    monkeypatch.setattr(statistics, "DRAWN", 200)


def kept(mean: float, spread: float, seed: int) -> dict[str, Any]:
    """Return what would be kept of normally distributed errors, a little different for each seed."""
    mean *= 1.0 + 0.02 * np.random.default_rng((seed, round(1e4 * mean))).normal()
    quantiles = np.linspace(mean - 2 * spread, mean + 2 * spread, 201).tolist()
    numbers = {"count": 1000, "mean": mean, "variance": spread**2, "before": mean, "during": mean}
    return numbers | {"quantiles": quantiles, "trial": LINE}


def rows(means: dict[str, float], spreads: dict[str, float] | None = None) -> list[tuple[Cell, Row]]:
    """Return cells and rows in which each setting has these means, and spreads, of errors."""
    spreads = spreads or {"Color only": 0.05, "Position only": 0.05, "All": 0.04}
    pairs: list[tuple[Cell, Row]] = []
    for seed in range(SEEDS):
        for setting in SETTINGS:
            errors = {finger: kept(means[setting], spreads[setting], seed) for finger in FINGERS}
            cell = {"setting": setting, "seed": seed, "trials": 3, "prototypes": 10, "eta": 0.1}
            sample = {name: [0.0, 1.0] for name in ("time", *SETTINGS["All"], *FINGERS.values())}
            pairs.append((cell, {"steps": 9, "readings": {"α / c": errors}, "sample": sample}))
    return pairs


def found(means: dict[str, float], spreads: dict[str, float] | None = None) -> Findings:
    return _found(tuple(means.items()), tuple(spreads.items()) if spreads else None)


@cache
def _found(means: tuple[tuple[str, float], ...], spreads: tuple[tuple[str, float], ...] | None) -> Findings:
    return EXPERIMENT.find(rows(dict(means), dict(spreads) if spreads else None), Options())


def claim(findings: Findings, said: str) -> Claim:
    return next(claim for claim in findings.claims if said in claim.said)


def test_all_that_errs_less_is_better_and_flipped_data_flip_the_verdict() -> None:
    for said in ("better than each", "better by at least", "During the grasp"):
        assert claim(found(USUAL), said).verdict == Verdict.REPRODUCED
        assert claim(found(FLIPPED), said).verdict == Verdict.NOT_REPRODUCED


def test_what_is_better_by_less_than_a_small_effect_is_better_and_no_more() -> None:
    findings = found({"Color only": 0.075, "Position only": 0.075, "All": 0.07})
    assert claim(findings, "better than each").verdict == Verdict.REPRODUCED
    assert claim(findings, "better by at least").verdict == Verdict.DIFFERS


def test_what_beats_one_of_both_is_not_reproduced_and_says_which() -> None:
    findings = found({"Color only": 0.10, "Position only": 0.04, "All": 0.07})
    assert claim(findings, "better than each").verdict == Verdict.NOT_REPRODUCED
    assert "“Position only” (not reproduced)" in claim(findings, "better than each").because
    assert claim(findings, "For ring").verdict == Verdict.REPRODUCED, "which is better there by position alone"


def test_what_seeds_do_not_agree_on_is_undecided() -> None:
    pairs = [
        (cell, row)
        for one, other in zip(rows(USUAL), rows(FLIPPED), strict=True)
        for cell, row in (other if one[0]["seed"] % 2 else one,)
    ]
    findings = EXPERIMENT.find(pairs, Options())
    for said in ("better than each", "better by at least", "During the grasp"):
        assert claim(findings, said).verdict == Verdict.UNDECIDED


def test_medians_that_are_nearly_the_same_are() -> None:
    same = {"Color only": 0.070, "Position only": 0.071, "All": 0.072}
    assert claim(found(same), "median of ring").verdict == Verdict.REPRODUCED
    assert claim(found(USUAL), "median of ring").verdict == Verdict.NOT_REPRODUCED


def test_narrower_errors_are_narrower() -> None:
    wide = {"Color only": 0.05, "Position only": 0.05, "All": 0.06}
    for finger in FINGERS:
        said = f"variance of {finger}"
        assert claim(found(USUAL), said).verdict == Verdict.REPRODUCED
        assert claim(found(USUAL, spreads=wide), said).verdict == Verdict.NOT_REPRODUCED


def test_a_learner_that_diverged_is_told() -> None:
    pairs = rows(USUAL)
    broken: Any = pairs[2][1]["readings"]["α / c"]
    broken["ring"] = None
    findings = EXPERIMENT.find(pairs, Options())
    assert [each.verdict for each in findings.claims] == [Verdict.NOT_REPRODUCED]
    assert "diverged with All" in findings.claims[0].ours
    assert [figure.name for figure in findings.figures] == ["stream"]
    assert any("diverged" in row for row in findings.tables[0].rows)


def test_cohens_d_is_that_of_the_errors() -> None:
    ours, others = np.random.default_rng(1).gamma(2.0, 0.1, (2, 500)) + np.array([[0.0], [0.05]])

    def errors_of(values: Any) -> list[dict[str, Any]]:
        return [{"count": len(values), "mean": values.mean(), "variance": values.var(ddof=1)}]

    table = {("All", "ring"): errors_of(ours), ("Color only", "ring"): errors_of(others)}
    pooled = np.sqrt((ours.var(ddof=1) + others.var(ddof=1)) / 2)
    assert effect(table, "ring", "Color only").middle == pytest.approx((others.mean() - ours.mean()) / pooled)
    double = {key: [{"mean": 2.0 * (key[0] == "All") or 1.0}] for key in table}
    assert ratio(double, "mean", ("All", "ring"), ("Color only", "ring")).middle == 2.0


def test_errors_are_those_of_the_test_by_hand() -> None:
    rate, length = 10.0, 20_000
    button = np.zeros(length)
    button[::90] = 1.0
    ones = np.ones(length)
    columns = {"button": button, **dict.fromkeys(FINGERS.values(), ones)}
    last = np.arange(length) == length - 1
    made = Stream(columns, seen_ranges(columns), last, rate, "by hand")
    predicted = np.full(length, 0.5)  # a signal that is always the same lies in the middle of its range
    predicted[10_000:] += 0.25
    errors = OfPredictions(made, 10_000).errors("ring", predicted, shown=False)
    assert errors is not None
    assert errors["mean"] == pytest.approx(0.25)
    assert errors["variance"] == pytest.approx(0.0)
    assert errors["during"] == errors["before"] == pytest.approx(0.25)
    assert errors["count"] == 10_000 - 6_904, "what is left of the return after them weighs more than a thousandth"
    predicted[12_345] = np.nan
    assert OfPredictions(made, 10_000).errors("ring", predicted, shown=False) is None


def test_inputs_are_signals_and_their_traces() -> None:
    assert list(inputs("Color only")) == ["red", "green", "red_trace", "green_trace"]
    assert len(inputs("All")) == 8


def test_a_quick_one_is_smaller_and_every_cell_is_plain() -> None:
    quick, full = (EXPERIMENT.cells(Options(quick=quick)) for quick in (True, False))
    assert sum(map(EXPERIMENT.seconds, quick)) < 2 * 60, "on two processors"
    assert len(full) > len(quick)
    assert {cell["setting"] for cell in quick} == set(SETTINGS)
    assert all(cell["prototypes"] == 8000 for cell in full)


@pytest.mark.slow
def test_a_small_cell_is_measured_found_and_drawn(tmp_path: Any) -> None:
    pytest.importorskip("matplotlib")
    from rtagent.experiments.outcome import draw

    cells = [{"setting": setting, "seed": 0, "trials": 20, "prototypes": 200, "eta": 0.025} for setting in SETTINGS]
    measured = [(cell, EXPERIMENT.measure(cell)) for cell in cells]
    findings = EXPERIMENT.find(measured, Options())
    assert len(findings.claims) > 10
    for figure in findings.figures:
        assert draw(figure, tmp_path / figure.name).png.stat().st_size > 10_000
