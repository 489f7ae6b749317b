"""What is measured: errors of every representation on every stream, times of a step, features within 100 ms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from math import isnan
from typing import Any

import numpy as np

from rtagent import kernels
from rtagent.experience import FloatArray
from rtagent.experiments.experiment import Cell, Options, Row
from rtagent.experiments.representations.configurations import (
    DIMENSIONS,
    ETA,
    PROTOTYPES,
    Tiles,
    coder_of,
    tile_codings,
)
from rtagent.experiments.representations.signals import layout_of
from rtagent.experiments.representations.within import TIME, features_within
from rtagent.experiments.streams import (
    BoolArray,
    Lesson,
    Stream,
    follow,
    named,
    part_error,
    returns,
    step_time,
)
from rtagent.features import FeatureCoder, TileCoding, Tilings
from rtagent.learning import TrueOnlineTD
from rtagent.learning.traces import WORTH_COMPILING
from rtagent.specs import Spec

ALPHA, GAMMA, LAMBDA = 0.001, 0.9, 0.99
READINGS = {"printed": (ALPHA, False), "divided": (ALPHA, True), "equal": (0.2, True)}
"""How the thesis's step size is read: as that of each weight; divided by the number of active features; and, for
comparison, so that all have what 8,000 prototypes have as it is printed, 0.2 of all active features together.
"""
RECORDING = "recording"
ARMS: Mapping[str, Mapping[str, Any]] = {
    "arm, wrist held": {"name": "sorting"},
    "arm, wrist moving": {"name": "sorting", "wrist": True},
}
SEEDS, STREAMS = 5, 5
QUICK_SEEDS, QUICK_STREAMS, QUICK_PROTOTYPES, QUICK_TILES = 2, 3, (1000, 8000, 20_000), 7
TIMED_ROWS, SLOWLY_TIMED_ROWS, QUICK_TABLE_SEEDS = 2000, 400, 4


def cells(options: Options) -> list[Cell]:
    """Return the cells: on the simulated arm, and on the recording where one is given."""
    quick, streams = options.quick, QUICK_STREAMS if options.quick else STREAMS
    sources = dict(ARMS)
    if options.data is not None:
        sources[RECORDING] = _recording(str(options.data))
    errors = [cell for source, stream in sources.items() for cell in _errors(source, stream, streams, quick)]
    return [*errors, *_times(quick), *_within(quick)]


def _recording(file: str) -> dict[str, Any]:
    found = named("recording", file=file)
    return {"name": "recording", "file": file, "signals": layout_of(found.columns, found.told).needed}


def _errors(source: str, settings: Mapping[str, Any], streams: int, quick: bool) -> Iterator[Cell]:
    for shuffle in range(streams):
        common = {"source": source, "stream": {**settings, "shuffle": shuffle}}
        yield {"kind": "baseline", **common, "seed": 0}
        for dimensions in DIMENSIONS:
            for coder in _coders(dimensions, quick):
                yield {"kind": "error", **common, "dimensions": dimensions, **coder}


def _coders(dimensions: int, quick: bool) -> Iterator[dict[str, Any]]:
    for prototypes in QUICK_PROTOTYPES if quick else PROTOTYPES:
        for seed in range(QUICK_SEEDS if quick else SEEDS):
            yield {"prototypes": prototypes, "eta": ETA, "seed": seed}
    for each in _some(tile_codings(dimensions), QUICK_TILES) if quick else tile_codings(dimensions):
        yield {"tilings": each.tilings, "tiles": each.tiles, "seed": 0}


def _some(tiles: list[Tiles], count: int) -> list[Tiles]:
    """Return a few, evenly spread over their order by features, the first and the last among them."""
    ordered = sorted(tiles, key=lambda each: each.features)
    return [ordered[round(place)] for place in np.linspace(0, len(ordered) - 1, count)]


def _times(quick: bool) -> Iterator[Cell]:
    """Yield what is timed alone, in the plain numpy forms and in the compiled ones."""
    for plain in (True, False):
        for dimensions in DIMENSIONS:
            for prototypes in QUICK_PROTOTYPES if quick else PROTOTYPES:
                yield _time(plain, dimensions, {"prototypes": prototypes, "eta": ETA})
            for each in _some(tile_codings(dimensions), QUICK_TILES if quick else 2 * QUICK_TILES):
                yield _time(plain, dimensions, {"tilings": each.tilings, "tiles": each.tiles})


def _time(plain: bool, dimensions: int, coder: Mapping[str, Any]) -> Cell:
    stream = {"name": "sorting", "shuffle": 0}
    return {"kind": "time", "plain": plain, "stream": stream, "dimensions": dimensions, "seed": 0, **coder}


def _within(quick: bool) -> Iterator[Cell]:
    for dimensions in DIMENSIONS:
        for what in ("prototypes", "tilings"):
            for seed in range(QUICK_TABLE_SEEDS if quick else SEEDS):
                yield {"kind": "within", "dimensions": dimensions, "what": what, "seed": seed, "quick": quick}


def measure(cell: Cell) -> Row:
    """Measure a cell."""
    return MEASURES[cell["kind"]](cell)


def _error(cell: Cell) -> Row:
    """Return the errors under both readings of the step size, and the time of a step."""
    lesson, coder = _lesson(cell)
    truth = returns(lesson.signal, lesson.last, GAMMA)
    predicted = follow(lesson, coder, [_learner(coder, reading) for reading in READINGS])
    tenth = slice(-(len(lesson.signal) // 10), None)
    found = {
        reading: _plain(part_error(each, truth, tenth)) for reading, each in zip(READINGS, predicted, strict=True)
    }
    return found | {"features": coder.size, "active": coder.active, "step": _step(lesson, coder, TIMED_ROWS)}


def _baseline(cell: Cell) -> Row:
    """Return the errors of predictions that know nothing of the state.

    They are the mean of all before, the signal as it is, and what is learned with one feature, always active.
    """
    stream = _stream(cell)
    signal = stream.column(layout_of(stream.columns, stream.told).target)
    truth, tenth = returns(signal, stream.last, GAMMA), len(signal) // 10
    mean = np.full(len(signal), signal[:-tenth].mean())
    predictions = {"mean": mean, "as it is": signal, "constant": _with_a_constant(signal, stream.last)}
    errors = {name: part_error(each, truth, slice(-tenth, None)) for name, each in predictions.items()}
    return errors | {"told": stream.told}


def _with_a_constant(signal: FloatArray, last: BoolArray) -> FloatArray:
    """Return what is learned with a constant feature, as fast as with 8,000 prototypes: it follows the signal."""
    lesson = Lesson(np.zeros((len(signal), 1)), signal, last, GAMMA)
    coder = TileCoding(state={"nothing": Spec(low=0.0, high=1.0)}, layers=(Tilings(1, 1),))
    found: FloatArray = follow(lesson, coder, [_learner(coder, "equal")])[0]
    return found


def _time_of(cell: Cell) -> Row:
    if not cell["plain"]:
        lesson, coder = _lesson(cell)
        return {"features": coder.size, "active": coder.active, "step": _step(lesson, coder, TIMED_ROWS)}
    with kernels.plain():
        lesson, coder = _lesson(cell)
        return {"features": coder.size, "active": coder.active, "step": _step(lesson, coder, SLOWLY_TIMED_ROWS)}


def _within_time(cell: Cell) -> Row:
    found, bounded = features_within(TIME, cell["what"], cell["dimensions"], cell["seed"], quick=cell["quick"])
    return {"features": found, "bounded": bounded}


MEASURES = {"error": _error, "baseline": _baseline, "time": _time_of, "within": _within_time}


def _lesson(cell: Cell) -> tuple[Lesson, FeatureCoder]:
    stream = _stream(cell)
    layout = layout_of(stream.columns, stream.told)
    signals = layout.signals(cell["dimensions"])
    lesson = Lesson(stream.states(signals), stream.column(layout.target), stream.last, GAMMA)
    return lesson, coder_of(cell, stream.state(signals))


def _learner(coder: FeatureCoder, reading: str) -> TrueOnlineTD:
    alpha, divided = READINGS[reading]
    alpha = alpha / coder.active if divided else alpha
    size, active = max(coder.size, WORTH_COMPILING), coder.active  # a smaller learner would not be compiled
    return TrueOnlineTD(size=size, active=active, alpha=alpha, divide_alpha=False, gamma=GAMMA, lambda_=LAMBDA)


def _step(lesson: Lesson, coder: FeatureCoder, rows: int) -> float:
    step_time(lesson, coder, _learner(coder, "divided"), rows // 10)
    return step_time(lesson, coder, _learner(coder, "divided"), rows)


def _stream(cell: Cell) -> Stream:
    settings = dict(cell["stream"])
    signals = settings.pop("signals", None)
    frozen = None if signals is None else tuple((name, ends and tuple(ends)) for name, ends in signals.items())
    return _made(settings.pop("name"), frozen, **settings)


@lru_cache(maxsize=2)
def _made(name: str, signals: tuple[tuple[str, Any], ...] | None, **settings: Any) -> Stream:
    return named(name, **settings) if signals is None else named(name, signals=dict(signals), **settings)


def _plain(error: float) -> float | None:
    """Return an error as JSON can hold it: None where learning diverged."""
    return None if isnan(error) else error
