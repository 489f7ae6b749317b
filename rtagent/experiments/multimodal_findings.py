"""What the errors of the multimodal predictions say: claims, figures and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from rtagent.experience import FloatArray
from rtagent.experiments.experiment import Cell, Claim, Figure, Findings, Options, Row, Table, Verdict
from rtagent.experiments.grasping import COLOR, FINGERS, POSITION, SETTINGS
from rtagent.experiments.statistics import Interval, interval
from rtagent.experiments.style import boxes, series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

SMALL = 0.2
"""Cohen's least effect that is called small (Cohen, 1988)."""
NEARLY = 0.1
"""Medians that differ by less than this part are called nearly the same."""
ALL, OTHERS = "All", ("Color only", "Position only")

Errors = Mapping[str, Any]
Table_ = Mapping[tuple[str, str], Sequence[Errors]]
"""By input setting and finger: what is kept of the errors, for each seed."""


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Return what the thesis claims beside what was found, with each reading of α."""
    readings = list(pairs[0][1]["readings"])
    tables = {reading: _by_setting(pairs, reading) for reading in readings}
    claims = [claim for reading, table in tables.items() for claim in claims_of(table, reading)]
    figures = [_stream_figure(pairs)]
    for number, reading in enumerate(readings):
        if _diverged(tables[reading]):
            continue
        figures += [
            _trial_figure(pairs, reading, number),
            _box_figure(tables[reading], pairs, reading, number),
            _effect_figure(tables[reading], pairs, reading, number),
        ]
    return Findings(tuple(claims), tuple(figures), (_table(tables),))


def _by_setting(pairs: Sequence[tuple[Cell, Row]], reading: str) -> Table_:
    return {
        (setting, finger): [row["readings"][reading][finger] for cell, row in pairs if cell["setting"] == setting]
        for setting in SETTINGS
        for finger in FINGERS
    }


def _diverged(table: Table_) -> bool:
    return any(each is None for several in table.values() for each in several)


def claims_of(table: Table_, reading: str) -> list[Claim]:
    """Return the claims of sections 5.3 and 5.4, for one reading of α."""
    if _diverged(table):
        lost = sorted({setting for (setting, _), several in table.items() if None in several})
        said = f"Predictions are learned with α = 0.01 ({reading})"
        return [Claim(said, "learned", f"diverged with {', '.join(lost)}", Verdict.NOT_REPRODUCED)]
    effects = {(finger, other): effect(table, finger, other) for finger in FINGERS for other in OTHERS}
    return [
        _better(effects, reading),
        _ring_effects(effects, reading),
        _ring_medians(table, reading),
        *(_narrower(table, finger, reading) for finger in FINGERS),
        _middle_least(table, reading),
        _lower_before(table, reading),
        _worse_during(table, reading),
    ]


def effect(table: Table_, finger: str, other: str) -> Interval:
    """Return Cohen's d of the errors of another setting against those of "All", with its interval over seeds."""
    return interval([effect_of(*each) for each in zip(table[ALL, finger], table[other, finger], strict=True)])


def effect_of(ours: Errors, others: Errors) -> float:
    """Return Cohen's d of two distributions of errors: positive where ours are smaller."""
    a, b = ours["count"] - 1, others["count"] - 1
    pooled = np.sqrt((a * ours["variance"] + b * others["variance"]) / (a + b))
    return float((others["mean"] - ours["mean"]) / pooled)


def _better(effects: Mapping[tuple[str, str], Interval], reading: str) -> Claim:
    ours = {key: value for key, value in effects.items() if key[0] != "ring"}
    return Claim(
        f"“All” predicts middle and pinky better than either kind of sensors alone (α = 0.01 as {reading})",
        "a small to medium effect (Cohen's d) against both, figure 5.9",
        "; ".join(f"{finger} against {other}: d = {value}" for (finger, other), value in ours.items()),
        all_above(list(ours.values()), SMALL),
        _because(ours),
    )


def _because(effects: Mapping[tuple[str, str], Interval]) -> str:
    small = [f"{finger} against {other}" for (finger, other), each in effects.items() if each.low < SMALL]
    return f"not surely above {SMALL}: {', '.join(small)}" if small else ""


def _ring_effects(effects: Mapping[tuple[str, str], Interval], reading: str) -> Claim:
    color, position = (effects["ring", other] for other in OTHERS)
    return Claim(
        f"For ring there is such an effect against “Color only”, and none against “Position only” ({reading})",
        "a small to medium effect for all fingers with the exception of ring on “Position only”",
        f"d = {color} against color, {position} against position",
        both(above(color, SMALL), above(negated(position), -SMALL)),
    )


def _ring_medians(table: Table_, reading: str) -> Claim:
    ratio = over_seeds(table, lambda each: each[ALL, "ring"]["median"] / each["Position only", "ring"]["median"])
    return Claim(
        f"Ring's median error with “All” is nearly that with “Position only” ({reading})",
        "almost identical",
        f"“All” has {ratio} times the median of “Position only”",
        within(ratio, 1.0 - NEARLY, 1.0 + NEARLY),
    )


def _narrower(table: Table_, finger: str, reading: str) -> Claim:
    ratios = {
        other: over_seeds(
            table, lambda each, other=other: each[ALL, finger]["variance"] / each[other, finger]["variance"]
        )
        for other in OTHERS
    }
    theirs = "slightly smaller than with “Position only”" if finger == "ring" else "smaller than with the others"
    return Claim(
        f"The variance of {finger}'s errors is smaller with “All” ({reading})",
        theirs,
        "; ".join(f"{value} times that of {other}" for other, value in ratios.items()),
        all_above([negated(value) for value in ratios.values()], -1.0),
    )


def _middle_least(table: Table_, reading: str) -> Claim:
    ratios = [
        over_seeds(table, lambda each, s=setting, f=finger: each[s, "middle"]["variance"] / each[s, f]["variance"])
        for setting in SETTINGS
        for finger in ("ring", "pinky")
    ]
    return Claim(
        f"With every setting the variance of middle's errors is below that of ring's and pinky's ({reading})",
        "lower variance across all input settings",
        "; ".join(map(str, ratios)) + " times (three settings, ring and pinky each)",
        all_above([negated(ratio) for ratio in ratios], -1.0),
    )


def _lower_before(table: Table_, reading: str) -> Claim:
    ratios = {
        finger: over_seeds(
            table, lambda each, finger=finger: each["Position only", finger]["before"] / each[ALL, finger]["before"]
        )
        for finger in ("ring", "pinky")
    }
    return Claim(
        f"Before the hand closes, “Position only”, which knows no colour, errs more for ring and pinky ({reading})",
        "a large offset before the onset, which “All” does not have (figure 5.7)",
        "; ".join(f"{finger}: {value} times the error of “All”" for finger, value in ratios.items()),
        all_above(list(ratios.values()), 1.0),
    )


def _worse_during(table: Table_, reading: str) -> Claim:
    ratios = {
        finger: over_seeds(
            table, lambda each, finger=finger: each["Color only", finger]["during"] / each[ALL, finger]["during"]
        )
        for finger in FINGERS
    }
    return Claim(
        f"While the hand holds the object, “Color only” predicts no finger accurately, “All” does ({reading})",
        "not able to accurately predict any of the potentiometer values (figure 5.7)",
        "; ".join(f"{finger}: {value} times the error of “All”" for finger, value in ratios.items()),
        all_above(list(ratios.values()), 1.0),
    )


def over_seeds(table: Table_, statistic: Callable[[Any], float]) -> Interval:
    """Return a statistic of the errors of one seed, with its interval over seeds."""
    seeds = range(len(next(iter(table.values()))))
    return interval(
        [statistic({key: _with_median(several[seed]) for key, several in table.items()}) for seed in seeds]
    )


def _with_median(errors: Errors) -> dict[str, Any]:
    return {**errors, "median": errors["quantiles"][len(errors["quantiles"]) // 2]}


def negated(value: Interval) -> Interval:
    """Return the interval of the negative."""
    return Interval(-value.high, -value.middle, -value.low)


def above(value: Interval, limit: float) -> Verdict:
    """Say whether a value is surely above a limit, or surely below it."""
    if value.low > limit:
        return Verdict.REPRODUCED
    return Verdict.NOT_REPRODUCED if value.high < limit else Verdict.UNDECIDED


def all_above(values: Sequence[Interval], limit: float) -> Verdict:
    """Say whether all are surely above a limit; where some surely are and others surely not, it differs."""
    verdicts = {above(value, limit) for value in values}
    if len(verdicts) == 1:
        return verdicts.pop()
    both_are = {Verdict.REPRODUCED, Verdict.NOT_REPRODUCED} <= verdicts
    return Verdict.DIFFERS if both_are or Verdict.NOT_REPRODUCED in verdicts else Verdict.UNDECIDED


def both(*verdicts: Verdict) -> Verdict:
    """Join the verdicts on the parts of a claim."""
    if len(set(verdicts)) == 1:
        return verdicts[0]
    return Verdict.DIFFERS if Verdict.NOT_REPRODUCED in verdicts else Verdict.UNDECIDED


def within(value: Interval, low: float, high: float) -> Verdict:
    """Say whether a value surely lies between two limits, or surely does not."""
    if low < value.low and value.high < high:
        return Verdict.REPRODUCED
    outside = value.high < low or value.low > high
    return Verdict.NOT_REPRODUCED if outside else Verdict.UNDECIDED


def _table(tables: Mapping[str, Table_]) -> Table:
    rows = []
    for reading, table in tables.items():
        for (setting, finger), several in table.items():
            if None in several:
                rows.append((reading, setting, finger, "diverged", "", "", "", ""))
                continue
            each = [_with_median(one) for one in several]
            numbers = [
                interval([one[name] for one in each]) for name in ("mean", "median", "variance", "before", "during")
            ]
            rows.append((reading, setting, finger, *map(str, numbers)))
    head = ("α = 0.01 as", "inputs", "finger", "mean", "median", "variance", "before the grasp", "during it")
    return Table("Root squared errors after learning, over seeds with their intervals.", head, tuple(rows))


def _what(pairs: Sequence[tuple[Cell, Row]]) -> str:
    cell, row = pairs[0]
    seeds = len({cell["seed"] for cell, _ in pairs})
    return f"{cell['trials']} trials ({row['steps']:,} steps), {cell['prototypes']:,} prototypes, η {cell['eta']}, {seeds} seeds"


def _stream_figure(pairs: Sequence[tuple[Cell, Row]]) -> Figure:
    sample = next(row["sample"] for cell, row in pairs if cell["setting"] == ALL and "sample" in row)
    caption = f"Figure 5.6: a sample of the stream: the inputs of “All”, and the glove ({_what(pairs)})."
    return Figure("multimodal-stream", caption, partial(_draw_stream, sample=sample), (7.0, 4.5))


def _draw_stream(canvas: Canvas, sample: Mapping[str, Sequence[float]]) -> None:
    groups = {"position": POSITION, "colour": COLOR, "glove": tuple(FINGERS.values())}
    rows: Sequence[Axes] = canvas.subplots(len(groups), sharex=True)
    for axes, (title, names) in zip(rows, groups.items(), strict=True):
        for number, name in enumerate(names):
            series(axes, number, sample["time"], sample[name], name.replace("_", " "), marker="")
        axes.set_ylabel(f"{title}\n(0 to 1)")
        axes.legend(loc="upper right", ncols=3)
        axes.set_ylim(-0.05, 1.45)
    rows[-1].set_xlabel("time (s)")


def _trial_figure(pairs: Sequence[tuple[Cell, Row]], reading: str, number: int) -> Figure:
    trials = {
        (cell["setting"], finger): row["readings"][reading][finger]["trial"]
        for cell, row in pairs
        if "sample" in row
        for finger in FINGERS
    }
    caption = (
        "Figure 5.7: predictions, the sensor and its return in a trial of the test with the green cylinder "
        f"(α = 0.01 as {reading}; {_what(pairs)}, of which the first)."
    )
    return Figure(f"multimodal-trial-{number}", caption, partial(_draw_trial, trials=trials), (7.5, 5.5))


def _draw_trial(canvas: Canvas, trials: Mapping[tuple[str, str], Mapping[str, Sequence[float]]]) -> None:
    grid = canvas.subplots(len(FINGERS), len(SETTINGS), sharex=True, sharey=True)
    for row, finger in enumerate(FINGERS):
        for column, setting in enumerate(SETTINGS):
            axes, trial = grid[row][column], trials[setting, finger]
            for number, name in enumerate(("signal", "prediction", "return")):
                series(axes, number, trial["time"], trial[name], name, marker="")
            if not row:
                axes.set_title(setting)
            if not column:
                axes.set_ylabel(f"{finger} (0 to 1)")
    for axes in grid[-1]:
        axes.set_xlabel("time in the trial (s)")
    grid[0][0].legend(loc="upper left")


def _box_figure(table: Table_, pairs: Sequence[tuple[Cell, Row]], reading: str, number: int) -> Figure:
    caption = (
        "Figure 5.8: root squared errors in the test, without those beyond 2 standard deviations; boxes and "
        f"whiskers are those of all seeds together (α = 0.01 as {reading}; {_what(pairs)})."
    )
    return Figure(f"multimodal-errors-{number}", caption, partial(_draw_boxes, table=table))


def _draw_boxes(canvas: Canvas, table: Table_) -> None:
    axes = canvas.subplots()
    for number, setting in enumerate(SETTINGS):
        groups = [_kept(table[setting, finger]) for finger in FINGERS]
        positions = [place + 0.25 * (number - 1) for place in range(len(FINGERS))]
        boxes(axes, number, groups, positions, setting, width=0.22)
    axes.set_xticks(range(len(FINGERS)), list(FINGERS))
    axes.set_ylabel("root squared error (of the sensor's range)")
    axes.legend()


def _kept(several: Sequence[Errors]) -> FloatArray:
    """Return the errors of all seeds, as their quantiles, without outliers."""
    kept = []
    for each in several:
        found = np.array(each["quantiles"])
        kept.append(found[found < each["mean"] + 2.0 * np.sqrt(each["variance"])])
    return np.concatenate(kept)


def _effect_figure(table: Table_, pairs: Sequence[tuple[Cell, Row]], reading: str, number: int) -> Figure:
    caption = (
        "Figure 5.9: Cohen's d of the errors of single modalities against those of “All”, with intervals over "
        f"seeds; positive: “All” errs less (α = 0.01 as {reading}; {_what(pairs)})."
    )
    return Figure(f"multimodal-effects-{number}", caption, partial(_draw_effects, table=table), (6.0, 3.5))


def _draw_effects(canvas: Canvas, table: Table_) -> None:
    axes = canvas.subplots()
    for number, other in enumerate(OTHERS):
        found = [effect(table, finger, other) for finger in FINGERS]
        places = [place + 0.15 * (number - 0.5) for place in range(len(FINGERS))]
        series(axes, number, places, [each.middle for each in found], f"against {other}", linestyle="none")
        axes.vlines(places, [each.low for each in found], [each.high for each in found], color="0.4")
    for limit in (0.2, 0.5):
        axes.axhline(limit, color="0.6", linestyle=":")
    axes.set_xticks(range(len(FINGERS)), list(FINGERS))
    axes.set_xlabel("finger; dotted: a small and a medium effect")
    axes.set_ylabel("Cohen's d")
    axes.legend()
