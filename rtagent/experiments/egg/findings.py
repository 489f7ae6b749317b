"""All that is found in the trials of Experiment 2."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rtagent.experiments.egg.claims import claims
from rtagent.experiments.egg.conditions import CONTROL, REACTIVE_SARSA, SARSA
from rtagent.experiments.egg.figures import figures
from rtagent.experiments.egg.people import Group, grouped, percent, rate, times_as_many
from rtagent.experiments.egg.variants import EACH, MAIN, PRACTISED, alone
from rtagent.experiments.experiment import Cell, Findings, Options, Row, Table
from rtagent.experiments.statistics import interval
from rtagent.schedule import FIXED
from rtagent.units import degree

CONDITIONS = (CONTROL, SARSA, REACTIVE_SARSA)
NOTES = (
    "Groups of four people are drawn from all, as four took part in the thesis's experiment.",
    "Where nobody's egg breaks in a condition, half a broken egg stands in its place in ratios.",
)


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Find the claims, figures and tables of all trials."""
    groups = grouped(pairs)
    told = claims(groups[MAIN]) if MAIN in groups else []
    presets = {preset: groups[alone(preset)] for preset in FIXED if alone(preset) in groups}
    mixed = {name: group for name, group in groups.items() if name not in map(alone, FIXED)}
    return Findings(tuple(told), tuple(figures(groups)), (_of_variants(mixed), _of_presets(presets)), NOTES)


def _of_variants(groups: Mapping[str, Group]) -> Table:
    """Return failed stops in each condition, in all variants that mix the thesis's two algorithms."""
    rows = tuple(
        (name, str(len(group.people)), *_failed(group), str(times_as_many(group))) for name, group in groups.items()
    )
    conditions = ("control", f"its last {PRACTISED}", "SARSA", "reactive SARSA")
    head = ("variant", "people", *(f"{each} (%)" for each in conditions), "SARSA to reactive SARSA")
    return Table("Failed stops, with 95 % intervals over people.", head, rows)


def _failed(group: Group) -> list[str]:
    rates = [rate(group, each) for each in CONDITIONS]
    return [percent(each) for each in (rates[0], rate(group, CONTROL, PRACTISED), *rates[1:])]


def _of_presets(groups: Mapping[str, Group]) -> Table:
    """Return failed stops, and how close whole eggs were come to, where one schedule has all episodes."""
    rows = tuple(
        (
            preset,
            str(len(group.people)),
            percent(rate(group, preset, EACH)),
            _gap(group, preset),
            _short(group, preset),
        )
        for preset, group in groups.items()
    )
    head = ("schedule", "people", "failed (%)", "press to action (ms)", "distance from whole eggs (°)")
    caption = (
        f"One schedule in all episodes, to which people adapt: failed stops of the last {EACH}; 95 % intervals."
    )
    return Table(caption, head, rows)


def _gap(group: Group, condition: str) -> str:
    return str(interval(1e3 * group.gaps(condition)))


def _short(group: Group, condition: str) -> str:
    shorts = group.shorts(condition) / degree
    return str(interval(shorts[~np.isnan(shorts)]))
