"""What goes beyond the thesis, adaptive prototypes and SwiftTD: what is found turns where the rows turn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rtagent.experiments import adaptive_prototypes, statistics, swift_td
from rtagent.experiments.adaptive_prototypes import ADAPTIVE, FARTHER, FIXED
from rtagent.experiments.beyond import STREAMS, problem
from rtagent.experiments.experiment import Cell, Claim, Experiment, Findings, Options, Row, Verdict
from rtagent.experiments.streams import part_error

SEEDS = 8


@pytest.fixture(autouse=True)
def _fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "DRAWN", 200)


def claim(findings: Findings, said: str) -> Claim:
    return next(claim for claim in findings.claims if said in claim.said)


def prototypes(errors: dict[int, tuple[float, float]], spreads: tuple[float, float], step: float) -> Findings:
    """Find in rows with these errors of prototypes that stay and that move, and their spreads over seeds."""
    pairs: list[tuple[Cell, Row]] = []
    for stream in STREAMS:
        for size, (staying, moving) in errors.items():
            for seed in range(SEEDS):
                apart = np.random.default_rng(seed).normal()
                row = {
                    FIXED: {"error": staying + spreads[0] * apart, "step": 1e-6},
                    ADAPTIVE: {"error": moving + spreads[1] * apart, "step": step, "moved": 0.5},
                    FARTHER: {"error": moving, "step": step, "moved": 0.1},
                    "told": stream,
                }
                pairs.append(({"stream": stream, "prototypes": size, "seed": seed, "eta": 0.1}, row))
    return adaptive_prototypes.find(pairs, Options())


def test_prototypes_that_err_less_spread_less_and_take_longer_are_found_to() -> None:
    findings = prototypes({10: (0.2, 0.1), 20: (0.2, 0.15)}, (0.01, 0.001), 2e-6)
    flipped = prototypes({10: (0.1, 0.2), 20: (0.15, 0.2)}, (0.001, 0.01), 0.5e-6)
    for said in ("err less", "depend less", "take more time"):
        assert claim(findings, said).verdict == Verdict.REPRODUCED
        assert claim(flipped, said).verdict == Verdict.NOT_REPRODUCED
    assert len(findings.claims) == 3 * len(STREAMS)
    assert len(findings.tables[0].rows) == 2 * len(STREAMS) * 3


def test_what_holds_for_one_size_only_says_for_which_it_does_not() -> None:
    found = claim(prototypes({10: (0.2, 0.1), 20: (0.1, 0.2)}, (0.01, 0.01), 2e-6), "err less")
    assert found.verdict == Verdict.NOT_REPRODUCED
    assert found.because == "not so for 20 (not reproduced)"
    assert claim(prototypes({10: (0.2, 0.1)}, (0.01, 0.01), 2e-6), "depend less").verdict == Verdict.UNDECIDED


def test_prototypes_with_which_learning_diverges_are_told() -> None:
    pairs: list[tuple[Cell, Row]] = []
    for stream in STREAMS:
        row: Any = {kind: {"error": 0.1, "step": 1.0} for kind in (FIXED, ADAPTIVE, FARTHER)} | {"told": ""}
        pairs.append(({"stream": stream, "prototypes": 9, "seed": 0, "eta": 0.1}, row))
    pairs[1][1][FIXED]["error"] = None
    assert [each.verdict for each in adaptive_prototypes.find(pairs, Options()).claims] == [Verdict.NOT_REPRODUCED]


TRUE, SWIFT = swift_td.TRUE_ONLINE, swift_td.SWIFT


def learners(test: dict[str, float], before: dict[str, float], *diverged: str) -> Findings:
    """Find in rows with these errors of each learner and setting, in the test and before."""
    pairs: list[tuple[Cell, Row]] = []
    for stream in STREAMS:
        for seed in range(SEEDS):
            factor = 1.0 + 0.02 * np.random.default_rng(seed).normal()
            errors = {
                key: None if key in diverged and seed == 3 else {"test": each * factor, "chosen by": before[key]}
                for key, each in test.items()
            }
            cell = {"stream": stream, "prototypes": 9, "seed": seed, "eta": 0.1}
            pairs.append((cell, {"errors": errors, "told": stream}))
    return swift_td.find(pairs, Options())


def keys(true: tuple[float, float], swift: tuple[float, float]) -> dict[str, float]:
    return {f"{TRUE}, α 1": true[0], f"{TRUE}, α 2": true[1], f"{SWIFT}, α 1": swift[0], f"{SWIFT}, α 2": swift[1]}


def test_the_learner_that_errs_less_with_its_best_settings_is_better_and_flipped_it_is_not() -> None:
    before = keys((0.1, 0.2), (0.3, 0.2))
    better = learners(keys((0.2, 0.01), (0.01, 0.1)), before)
    assert claim(better, "grasping").verdict == Verdict.REPRODUCED
    assert "α 2; true online TD(λ), α 1" in claim(better, "grasping").ours, "chosen by what was before the test"
    worse = learners(keys((0.1, 0.01), (0.01, 0.2)), before)
    assert claim(worse, "sorting").verdict == Verdict.NOT_REPRODUCED


def test_settings_that_diverged_for_a_seed_are_not_chosen() -> None:
    before = keys((0.1, 0.2), (0.3, 0.2))
    findings = learners(keys((0.1, 0.1), (0.1, 0.1)), before, f"{TRUE}, α 1")
    assert "true online TD(λ), α 2" in claim(findings, "grasping").ours
    assert any("diverged, 1 seeds" in row for row in findings.tables[0].rows)


def test_a_learner_that_diverges_with_every_setting_is_told_and_errs_more() -> None:
    before, errs = keys((0.1, 0.2), (0.3, 0.2)), keys((0.2, 0.1), (0.1, 0.1))
    for learner, verdict in ((SWIFT, Verdict.NOT_REPRODUCED), (TRUE, Verdict.REPRODUCED)):
        lost = [key for key in errs if key.startswith(learner)]
        found = claim(learners(errs, before, *lost), "grasping")
        assert (found.ours, found.verdict) == (f"{learner} diverged with every setting", verdict)


@pytest.mark.parametrize("experiment", [adaptive_prototypes.EXPERIMENT, swift_td.EXPERIMENT])
def test_quick_ones_are_smaller(experiment: Experiment) -> None:
    quick, full = (sum(map(experiment.seconds, experiment.cells(Options(quick=each)))) for each in (True, False))
    assert quick < 2 * 60
    assert quick < full / 3


@pytest.mark.slow
@pytest.mark.parametrize("stream", STREAMS)
def test_cells_are_measured_and_better_than_the_mean_of_what_was_before(stream: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from rtagent.experiments.outcome import draw

    cell = {"stream": stream, "every": 25, "prototypes": 1000, "eta": 0.025, "seed": 0}
    given = problem(stream, 25)
    known = given.truth.known[: given.tested]
    mean = np.full(len(given.states), given.truth.values[: given.tested][known].mean())
    nothing = part_error(mean, given.truth, slice(given.tested, None))
    moving, learned = adaptive_prototypes.measure(cell), swift_td.measure(cell)
    assert max(moving[kind]["error"] for kind in (FIXED, ADAPTIVE, FARTHER)) < nothing
    assert moving[ADAPTIVE]["moved"] > moving[FARTHER]["moved"] > 0
    assert min(each["test"] for each in learned["errors"].values() if each) < 0.8 * nothing
    other = next(name for name in STREAMS if name != stream)
    for experiment, row in ((adaptive_prototypes.EXPERIMENT, moving), (swift_td.EXPERIMENT, learned)):
        pairs = [(cell, row), (cell | {"stream": other}, row)]
        for figure in experiment.find(pairs, Options()).figures:
            assert draw(figure, tmp_path / figure.name).png.stat().st_size > 5_000
