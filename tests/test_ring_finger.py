"""Chapter 6: η, sets of prototypes, several η: what a cell measures, and what follows from rows."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from rtagent.experiments import eta, prototype_sets, several_eta, statistics
from rtagent.experiments.experiment import Cell, Claim, Experiment, Findings, Options, Row, Verdict
from rtagent.experiments.ring_finger import problem as learned
from rtagent.experiments.ring_finger.measuring import measure
from rtagent.experiments.ring_finger.problem import DIVIDED, READINGS, cell_of, error_of, problem, time_of
from rtagent.sweeps.store import key_of

TRIALS = 8
EXPERIMENTS = (eta.EXPERIMENT, prototype_sets.EXPERIMENT, several_eta.EXPERIMENT)
SEEDS = 10
READINGS_EACH = next(iter(READINGS))
ErrorOf = Callable[[Cell], float | None]


@pytest.fixture(scope="module")
def few_trials() -> Iterator[None]:
    """Make the stream that is learned a short one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learned, "TRIALS", TRIALS)
        problem.cache_clear()
        yield
        problem.cache_clear()


@pytest.fixture(autouse=True)
def fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make intervals from fewer samples: hand-made rows are clear enough."""
    monkeypatch.setattr(statistics, "DRAWN", 200)


@pytest.mark.slow
@pytest.mark.usefixtures("few_trials")
def test_in_haste_the_same_is_learned_from_fewer_rows() -> None:
    whole, quick = problem(1), problem(25)
    assert len(whole.signal) == pytest.approx(TRIALS * 9 * 750, rel=0.01)
    assert np.array_equal(quick.states, whole.states[::25])
    assert quick.states.shape[1] == 8
    assert quick.gamma == pytest.approx(0.999**25)
    assert quick.until == round(0.8 * len(quick.signal))
    known = quick.truth.known
    # a return over the same time is nearly the same
    assert np.abs(quick.truth.values - whole.truth.values[::25])[known].max() < 0.03


@pytest.mark.usefixtures("few_trials")
def test_a_cell_is_measured_and_one_that_diverges_is_told() -> None:
    settings: list[tuple[int, list[float], int]] = [(200, [0.025], 1), (400, [0.03], 4), (100, [0.1, 0.05], 1)]
    for prototypes, etas, sets in settings:
        row = error_of(json.loads(json.dumps(cell_of(prototypes, etas, 0, 25, sets))))
        assert row["active"] == round(prototypes * sum(etas))
        assert all(0 < row[reading] < 0.5 for reading in READINGS)
    wild = error_of(cell_of(12_000, [0.1], 0, 25))
    assert wild[READINGS_EACH] is None
    assert wild[DIVIDED] is not None


@pytest.mark.slow
@pytest.mark.usefixtures("few_trials")
def test_a_step_of_more_prototypes_takes_longer_in_plain_numpy() -> None:
    few, many = (time_of(cell_of(size, [0.05], 0, 25, kind="time", plain=True))["step"] for size in (200, 40_000))
    assert many > 3 * few > 0


def test_distances_are_those_to_the_nearest_prototype() -> None:
    row = measure({"kind": "distance", "dimensions": 2, "prototypes": 50, "seeds": [3]})
    rng = np.random.default_rng(3)
    placed, points = rng.random((50, 2)), rng.random((200, 2))
    nearest = np.linalg.norm(points[:, None] - placed[None], axis=2).min(axis=1)
    np.testing.assert_allclose(row["distances"][0], nearest, atol=1e-7)


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda each: each.name)
def test_in_full_there_are_forty_seeds_on_every_row_and_cells_are_plain_data(experiment: Experiment) -> None:
    cells = experiment.cells(Options())
    errors = [cell for cell in cells if cell["kind"] == "error"]
    assert {cell["seed"] for cell in errors} == set(range(40))
    assert {cell["every"] for cell in errors} == {1}
    assert json.loads(json.dumps(cells)) == cells
    assert all(experiment.seconds(cell) > 0 for cell in cells)
    assert len(experiment.cells(Options(quick=True))) < len(cells) / 5


def test_the_three_have_their_errors_with_one_set_and_one_eta_in_common() -> None:
    sweep, sets, several = ({key_of(each.measure, cell) for cell in each.cells(Options())} for each in EXPERIMENTS)
    assert len(sweep & sets & several) == len(eta.ETAS) * 40
    assert len(sweep & several) == len(several_eta.SIZES) * len(eta.ETAS) * 40


def test_no_cell_has_an_eta_that_leaves_nothing_active() -> None:
    for experiment in EXPERIMENTS:
        for cell in experiment.cells(Options()):
            if cell["kind"] == "error":
                assert cell["prototypes"] // cell["sets"] * min(cell["etas"]) >= 1.0 - 1e-9


def as_the_thesis_says(cell: Cell) -> float:
    """Return an error by which every claim comes out; seeds vary it more where prototypes of a set are few."""
    size, seed = cell["prototypes"] / cell["sets"], cell["seed"]
    worth = size * (8 if len(cell["etas"]) == 16 else 1.1 if len(cell["etas"]) == 2 else 1)
    best = 0.01 + 100.0 / worth + 0.001 * abs(np.log(cell["etas"][0] / 0.01))
    varied = {1: 0.4, 2: 0.05}.get(len(cell["etas"]), 0.4) * (500 / size) ** 0.5
    return best * (1.0 + 0.1 * varied * ((seed % 5) - 2))


def rows_of(cells: list[Cell], error: ErrorOf) -> Iterator[Row]:
    for cell in cells:
        if cell["kind"] == "distance":
            rng = np.random.default_rng(0)
            yield {"distances": [(rng.random(20) / cell["prototypes"]).tolist() for _ in range(5)]}
        elif cell["kind"] == "time":
            sets = cell["sets"]
            bowl = 1.0 if sets == 1 else 0.5 if sets == 4 else 0.4 if sets == 8 else 0.6 if sets < 32 else 2.0
            yield {"step": cell["prototypes"] / 8000 * bowl * 1e-3 * (1.0 + 0.01 * cell["seed"]), "told": "mine"}
        else:
            lost = cell["etas"] == list(several_eta.SIXTEENS[0])
            yield dict.fromkeys(READINGS, None if lost else error(cell)) | {"active": 1, "told": "hand-made rows"}


def found(experiment: Experiment, error: ErrorOf = as_the_thesis_says) -> Findings:
    cells = list(experiment.cells(Options()))
    cells = [cell for cell in cells if cell.get("seed", 0) < SEEDS]
    return experiment.find(list(zip(cells, rows_of(cells, error), strict=True)), Options())


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda each: each.name)
def test_rows_as_the_thesis_says_reproduce_every_claim(experiment: Experiment) -> None:
    claims = found(experiment).claims
    assert [claim for claim in claims if claim.verdict is not Verdict.REPRODUCED] == []
    assert len(claims) >= 8


FLIPS: list[tuple[Experiment, str, ErrorOf]] = [
    (eta.EXPERIMENT, "more prototypes err less", lambda cell: 1.0 + cell["prototypes"]),
    (eta.EXPERIMENT, "diminishing returns", lambda cell: 1.0 + 1e-9 * (13_000 - cell["prototypes"]) ** 3),
    (eta.EXPERIMENT, "performed best of all", lambda cell: abs(cell["prototypes"] - 8000.0) + 1.0),
    (eta.EXPERIMENT, "how prototypes are drawn", lambda cell: 2.0 + cell["seed"] * cell["prototypes"] / 1e6),
    (prototype_sets.EXPERIMENT, "no advantage", lambda cell: 2.0 - 0.1 * cell["sets"]),
    (prototype_sets.EXPERIMENT, "the smaller a set", lambda cell: 2.0 + 0.1 * cell["seed"] / cell["sets"]),
    (several_eta.EXPERIMENT, "err less with 16", lambda cell: 1.0 + len(cell["etas"])),
    (several_eta.EXPERIMENT, "not as good as", lambda cell: 2.0 / len(cell["etas"])),
    (several_eta.EXPERIMENT, "little different", lambda cell: 1.0 + len(cell["etas"]) % 16),
    (several_eta.EXPERIMENT, "and vary less", lambda cell: 2.0 + 0.1 * cell["seed"] * (len(cell["etas"]) == 2)),
]


@pytest.mark.parametrize(("experiment", "text", "error"), FLIPS, ids=[text for _, text, _ in FLIPS])
def test_flipped_rows_flip_the_verdict(experiment: Experiment, text: str, error: ErrorOf) -> None:
    claims: list[Claim] = [claim for claim in found(experiment, error).claims if text in claim.said]
    assert len(claims) == len(READINGS)
    assert {claim.verdict for claim in claims} == {Verdict.NOT_REPRODUCED}


@pytest.mark.slow
@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda each: each.name)
def test_what_diverges_everywhere_is_told_and_drawn(experiment: Experiment) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    findings = found(experiment, lambda cell: None if cell["etas"][0] > 0.04 else as_the_thesis_says(cell))
    assert Verdict.REPRODUCED in {claim.verdict for claim in findings.claims}
    for figure in findings.figures:
        canvas = Figure()
        figure.draw(canvas)
        assert all(axes.get_ylabel() for axes in canvas.axes)


def test_a_time_without_a_bowl_is_not_one() -> None:
    experiment: Any = prototype_sets.EXPERIMENT
    cells = [cell for cell in experiment.cells(Options()) if cell.get("seed", 0) < SEEDS]
    rows = [
        row | {"step": 1e-3 * cell["sets"]} if cell["kind"] == "time" else row
        for cell, row in zip(cells, rows_of(cells, as_the_thesis_says), strict=True)
    ]
    findings = experiment.find(list(zip(cells, rows, strict=True)), Options())
    bowls = [claim for claim in findings.claims if "bowl" in claim.said or "half" in claim.said]
    assert {claim.verdict for claim in bowls} == {Verdict.NOT_REPRODUCED}
    assert len(bowls) == 4
