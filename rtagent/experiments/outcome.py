"""What became of an experiment: what it found, its figures as files, and whatever failed of it."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rtagent.errors import RtagentError
from rtagent.experiments import style
from rtagent.experiments.experiment import Cell, Experiment, Figure, Findings, Options, Row
from rtagent.sweeps.compute import MeasuringError

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Measurements = Callable[[Experiment, Sequence[Cell]], Sequence[Row]]


@dataclass(frozen=True)
class Drawn:
    """A figure as files."""

    caption: str
    png: Path
    svg: Path


@dataclass(frozen=True)
class Failed:
    """What failed, in a sentence, and where."""

    sentence: str
    trace: str = ""


@dataclass(frozen=True)
class Outcome:
    """All that came of an experiment; what failed may leave the rest."""

    experiment: Experiment
    cells: Sequence[Cell] = ()
    findings: Findings = field(default_factory=Findings)
    figures: Sequence[Drawn] = ()
    failures: Sequence[Failed] = ()
    seconds: float = 0.0
    """How long measuring its cells took, on one processor."""

    @property
    def seeds(self) -> Sequence[int]:
        """The seeds of its cells, sorted."""
        return sorted({seed for cell in self.cells for seed in _seeds(cell)})


def carry_out(experiment: Experiment, options: Options, measurements: Measurements, folder: Path) -> Outcome:
    """Do an experiment, and draw its figures into a folder; what fails is in the outcome."""
    cells: Sequence[Cell] = ()
    try:
        cells = experiment.cells(options)
        rows = measurements(experiment, cells)
        findings = experiment.find(list(zip(cells, rows, strict=True)), options)
    except Exception as error:  # an experiment that fails must not take the others with it
        return Outcome(experiment, cells, failures=list(_failures(error)))
    figures, failures = list[Drawn](), list[Failed]()
    for figure in findings.figures:
        try:
            figures.append(draw(figure, folder / f"{experiment.name}-{figure.name}"))
        except Exception as error:  # nor one figure the rest
            failures += _failures(error, f"figure {figure.name}: ")
    return Outcome(experiment, cells, findings, figures, failures)


def draw(figure: Figure, stem: Path) -> Drawn:
    """Draw a figure, and write it as PNG and SVG."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    return Drawn(figure.caption, *style.save(canvas_of(figure), stem))


def canvas_of(figure: Figure) -> Canvas:
    """Draw a figure in the style of all."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    with mpl.rc_context(style.SETTINGS):
        canvas = Canvas(figsize=figure.size, layout="constrained")
        figure.draw(canvas)
    return canvas


def _failures(error: Exception, where: str = "") -> Iterator[Failed]:
    if isinstance(error, MeasuringError):
        yield Failed(f"{where}{error}", error.failures[0].trace)
    elif isinstance(error, RtagentError):
        yield Failed(f"{where}{error}")
    else:
        yield Failed(f"{where}{type(error).__name__}: {error}", "".join(traceback.format_exception(error)))


def _seeds(cell: Cell) -> Iterator[int]:
    seed = cell.get("seed", cell.get("seeds", ()))
    yield from [seed] if isinstance(seed, int) else seed
