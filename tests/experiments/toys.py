"""Experiments that take no time, for the tests: one that works, and some that fail where they are told to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure as Canvas

from rtagent.experiments import style
from rtagent.experiments.experiment import Cell, Claim, Experiment, Figure, Findings, Options, Row, Table, Verdict

CALLED: list[int] = []


def cells(options: Options) -> list[dict[str, Any]]:
    return [{"seed": seed} for seed in range(1, 3 if options.quick else 6)]


def measure(cell: Cell) -> Row:
    CALLED.append(cell["seed"])
    return {"found": 10 * cell["seed"]}


def fail(cell: Cell) -> Row:
    raise RuntimeError(f"no <b>{cell['seed']}</b> today")


def draw(canvas: Canvas) -> None:
    axes = canvas.add_subplot()
    for number in range(10):
        style.series(axes, number, [0, 1, 2], [number, number + 1, number], str(number))


def draw_nothing(canvas: Canvas) -> None:
    raise ZeroDivisionError("nothing to draw")


def find(pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], options: Options) -> Findings:
    total = sum(row["found"] for _, row in pairs)
    claims = tuple(Claim(f"a <claim> & {each}", "some", str(total), each) for each in Verdict)
    table = Table(
        "numbers", ("seed", "found"), tuple((str(cell["seed"]), str(row["found"])) for cell, row in pairs)
    )
    return Findings(claims, (Figure("lines", "Lines <of> ten series.", draw),), (table,), ("a note",))


def find_undrawable(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    return Findings((Claim("said", "a", "b", Verdict.DIFFERS),), (Figure("nothing", "Nothing.", draw_nothing),))


def toy(name: str, **changes: Any) -> Experiment:
    given = {"cells": cells, "measure": measure, "find": find, "seconds": lambda cell: 2.0, **changes}
    return Experiment(name, f"The toy {name}", "Section 0", models=("It models nothing.",), **given)
