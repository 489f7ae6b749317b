"""Tile coding against selective Kanerva coding: what is compared, what a cell measures, what follows from rows."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_prediction_streams import own_recording

from rtagent import Spec
from rtagent.errors import SpecError
from rtagent.experiments import statistics
from rtagent.experiments.experiment import Cell, Claim, Findings, Options, Row, Verdict
from rtagent.experiments.representations import EXPERIMENT
from rtagent.experiments.representations.cells import ARMS
from rtagent.experiments.representations.configurations import (
    DIMENSIONS,
    LEAST,
    MOST,
    PROTOTYPES,
    coder_of,
    tile_codings,
)
from rtagent.experiments.representations.signals import ARMPI, BENTO, layout_of
from rtagent.experiments.representations.times import THESIS
from rtagent.experiments.representations.within import features_within
from rtagent.experiments.streams import named
from rtagent_drivers.tables import Table, write_table

ARM = "arm, wrist held"


@pytest.fixture(autouse=True)
def fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make intervals from fewer samples: hand-made rows are clear enough."""
    monkeypatch.setattr(statistics, "DRAWN", 200)


def test_there_are_exactly_248_tile_codings_from_128_to_331776_features() -> None:
    codings = [each for dimensions in DIMENSIONS for each in tile_codings(dimensions)]
    assert len(codings) == len(set(codings)) == 248
    assert (min(each.features for each in codings), max(each.features for each in codings)) == (128, 331_776)
    assert (LEAST, MOST) == (128, 331_776)
    assert {each.tilings for each in tile_codings(12)} == set(range(1, 82))  # all that fit: 81 · 2¹² is the most
    assert {(each.tilings, each.tiles) for each in tile_codings(8)} >= {(50, 3), (5, 4), (1024, 2)}


@pytest.mark.parametrize("dimensions", DIMENSIONS)
def test_a_tile_coding_has_as_many_features_as_it_says_and_covers_the_ranges(dimensions: int) -> None:
    state = {str(number): Spec(low=0.0, high=1.0) for number in range(dimensions)}
    for each in tile_codings(dimensions)[::7]:
        coder = coder_of({"tilings": each.tilings, "tiles": each.tiles}, state)
        assert (coder.size, coder.active) == (each.features, each.tilings)
    corners = [coder.encode(np.full(dimensions, end)).indices for end in (0.0, 1.0)]
    assert corners[0].min() >= 0
    assert corners[1].max() < coder.size
    assert not np.array_equal(*corners)


def test_prototypes_are_those_of_the_thesis_and_so_many_are_active() -> None:
    assert (PROTOTYPES[0], PROTOTYPES[-1]) == (1000, 20_000)
    state = {"a": Spec(low=0.0, high=1.0)}
    assert [coder_of({"prototypes": number, "seed": 0}, state).active for number in (1000, 8000)] == [25, 200]


@pytest.mark.parametrize("layout", [BENTO, ARMPI])
def test_more_dimensions_are_those_of_more_joints(layout: Any) -> None:
    two, eight, twelve = (layout.signals(dimensions) for dimensions in DIMENSIONS)
    assert (len(two), len(eight), len(twelve)) == (2, 8, 12)
    assert set(two) < set(eight) < set(twelve)
    assert layout.target not in twelve


def test_with_two_dimensions_elbow_and_load_are_seen_of_the_simulated_arm() -> None:
    assert BENTO.signals(2) == ["elbow_position", "elbow_load"]
    assert set(BENTO.signals(12)) <= set(named("sorting", trials=1).columns)


def test_the_cells_are_what_the_thesis_did() -> None:
    cells = EXPERIMENT.cells(Options())
    errors = [cell for cell in cells if cell["kind"] == "error" and cell["source"] == ARM]
    tiles = {(cell["dimensions"], cell["tilings"], cell["tiles"]) for cell in errors if "tilings" in cell}
    kanerva = {(cell["dimensions"], cell["prototypes"], cell["seed"]) for cell in errors if "prototypes" in cell}
    assert len(tiles) == 248
    assert len(kanerva) == 3 * len(PROTOTYPES) * 5
    assert len(errors) == 5 * (len(tiles) + len(kanerva))
    assert json.loads(json.dumps(cells)) == cells
    assert len({json.dumps(cell, sort_keys=True) for cell in cells}) == len(cells)
    assert len(cells) > 3 * len(EXPERIMENT.cells(Options(quick=True)))


def small(**further: Any) -> Cell:
    return {
        "kind": "error",
        "source": ARM,
        "stream": {**ARMS[ARM], "trials": 1},
        "dimensions": 8,
        "seed": 0,
    } | further


@pytest.mark.parametrize("coder", [{"prototypes": 200, "eta": 0.025}, {"tilings": 16, "tiles": 2}])
def test_a_cell_is_measured_the_same_each_time_but_for_its_times(coder: dict[str, Any]) -> None:
    one, other = (EXPERIMENT.measure(small(**coder)) for _ in range(2))
    assert one.items() - {("step", one["step"])} == other.items() - {("step", other["step"])}
    assert one["features"] == (200 if "prototypes" in coder else 16 * 2**8)
    assert 0 < one["equal"] < one["divided"]
    assert one["step"] > 0


def test_what_has_not_the_columns_is_refused_with_those_that_are_needed(tmp_path: Path) -> None:
    own_recording(tmp_path / "mine.csv")
    with pytest.raises(SpecError, match=r"m_position|elbow_position"):
        EXPERIMENT.cells(Options(data=tmp_path / "mine.csv"))
    with pytest.raises(SpecError, match="shoulder_position"):
        layout_of(["elbow_position"], "mine")


def test_a_recording_is_measured_as_the_arm_is(tmp_path: Path) -> None:
    rng, rows = np.random.default_rng(0), 2000
    columns = {name: rng.uniform(*(ends or (0, 1)), rows) for name, ends in ARMPI.needed.items()}
    columns["m1_position"] = np.full(rows, -1.0)  # what is not needed may be anything
    path = tmp_path / "mine.csv.gz"
    write_table(Table(np.arange(rows) / 10, ["a"] * 1000 + ["b"] * 1000, columns), path)
    cells = [cell for cell in EXPERIMENT.cells(Options(quick=True, data=path)) if cell.get("source") == "recording"]
    assert {cell["stream"]["shuffle"] for cell in cells} == {0, 1, 2}
    row = EXPERIMENT.measure(json.loads(json.dumps(cells[1])))
    assert 0 < row["divided"] < 1000
    assert EXPERIMENT.measure(cells[0])["told"].startswith("mine.csv.gz: 2,000 rows in 2 sessions")


@pytest.mark.slow
def test_more_features_fit_into_more_time() -> None:
    short, long = (features_within(seconds, "tilings", 2, 0, quick=True).features for seconds in (1e-4, 1e-2))
    assert 20 < long / short < 500


ErrorOf = Callable[[str, Cell], float]


def as_the_thesis_says(reading: str, cell: Cell) -> float:
    """Return an error by which every claim comes out: convex, and better with each dimension of prototypes."""
    if "tilings" in cell:
        return 2.0 + 0.01 * cell["dimensions"]
    return 1.0 + abs(np.log(cell["prototypes"] / 8000)) - 0.02 * cell["dimensions"]


def rows_of(cells: list[Cell], error: ErrorOf) -> Iterator[Row]:
    rng = np.random.default_rng(0)
    for cell in cells:
        if cell["kind"] == "baseline":
            yield {"mean": 3.0, "as it is": 0.1, "constant": 0.2, "told": "hand-made"}
        elif cell["kind"] == "within":
            mean, _ = THESIS[cell["what"], cell["dimensions"]]
            yield {"features": mean + cell["seed"], "bounded": False}
        else:
            features = cell.get("prototypes") or cell["tilings"] * cell["tiles"] ** cell["dimensions"]
            step = features * (1e-9 if "tilings" in cell else 1e-7 * cell["dimensions"])
            errors = {
                name: error(name, cell) * rng.uniform(0.999, 1.001) for name in ("printed", "divided", "equal")
            }
            yield {**errors, "features": features, "active": 1, "step": step}


def found(error: ErrorOf = as_the_thesis_says) -> Findings:
    options = Options(quick=True)
    cells = list(EXPERIMENT.cells(options))
    return EXPERIMENT.find(list(zip(cells, rows_of(cells, error), strict=True)), options)


def about(findings: Findings, text: str) -> list[Claim]:
    claims = [claim for claim in findings.claims if text in claim.said and ARM in claim.said]
    assert claims, text
    return claims


def test_rows_as_the_thesis_says_reproduce_every_claim() -> None:
    findings = found()
    others = [claim for claim in findings.claims if claim.verdict is not Verdict.REPRODUCED]
    assert others == []
    assert len(findings.claims) == 2 * 11 + 8 + 2
    assert any("No recording was given" in note for note in findings.notes)
    assert any("11 with α = 0.001 of each weight" in note for note in findings.notes)


FLIPS: list[tuple[str, ErrorOf]] = [
    ("err less than tile coding", lambda _, cell: 1.0 if "tilings" in cell else 2.0),
    ("err less with", lambda _, cell: 2.0 if "tilings" in cell else 1.0 + 0.02 * cell["dimensions"]),
    ("tile coding errs no less", lambda _, cell: 3.0 - 0.1 * cell["dimensions"]),
    ("best of all", lambda _, cell: 1.0 if "tilings" in cell else 2.0),
    ("and so do fewer", lambda _, cell: 3.0 if "tilings" in cell else 2.0 - cell["prototypes"] / 20_000),
    ("how prototypes are drawn", lambda _, cell: 1.0 + cell["seed"]),
]


@pytest.mark.parametrize(("text", "error"), FLIPS, ids=[text for text, _ in FLIPS])
def test_flipped_rows_flip_the_verdict(text: str, error: ErrorOf) -> None:
    assert {claim.verdict for claim in about(found(error), text)} == {Verdict.NOT_REPRODUCED}


def test_what_differs_from_stream_to_stream_is_undecided() -> None:
    def error(_: str, cell: Cell) -> float:
        return 2.0 + (-1) ** cell["stream"]["shuffle"] * ("tilings" in cell)

    assert {claim.verdict for claim in about(found(error), "err less than tile coding")} == {Verdict.UNDECIDED}


def test_a_representation_that_diverges_is_not_the_best() -> None:
    options = Options(quick=True)
    cells = list(EXPERIMENT.cells(options))
    rows = [
        row | {"printed": None} if cell.get("tilings") == 1 and cell["kind"] == "error" else row
        for cell, row in zip(cells, rows_of(cells, as_the_thesis_says), strict=True)
    ]
    findings = EXPERIMENT.find(list(zip(cells, rows, strict=True)), options)
    assert {claim.verdict for claim in about(findings, "err less than tile coding")} == {Verdict.REPRODUCED}


@pytest.mark.slow
def test_figures_can_be_drawn_and_say_what_was_run() -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    findings = found()
    assert [figure.name for figure in findings.figures][:2] == [
        "4.4-arm-wrist-held-printed",
        "4.4-arm-wrist-held-equal",
    ]
    for figure in (findings.figures[0], findings.figures[-1]):
        canvas = Figure()
        figure.draw(canvas)
        assert all(axes.get_xlabel() for axes in canvas.axes)
    assert "3 streams" in findings.figures[0].caption


def test_the_table_has_the_thesiss_numbers_beside_ours() -> None:
    table = found().tables[-1]
    assert ("selective Kanerva coding", "12", "10,884 ± 1", "10,883 ± 165") in table.rows
