"""What the runs of learned ordering showed: nothing is claimed by the thesis but that it may be possible."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.experiments.experiment import Cell, Claim, Findings, Options, Row, Table, Verdict
from rtagent.experiments.learned_ordering.figures import figures
from rtagent.experiments.learned_ordering.runs import FORETOLD, LEARNED, PARTS, RANDOM, SCHEDULES, WORLDS
from rtagent.experiments.statistics import Interval, above, all_of, interval, paired
from rtagent.schedule import FIXED

PROPOSED = "proposes it (6.3.1), with no number"
SECOND_PROCESSOR = "background"
RIVALS = tuple(name for name in FIXED if name != SECOND_PROCESSOR)
SETTINGS_NOTE = (
    "The orderer's settings (step size, discount, exploration, bins) were chosen on seeds 101 to 103 of the world "
    "phases, before the runs told here, and are the same in all worlds but for what says how urgent it is."
)
IN_SLICES = (
    "Learning goes in slices of 2 ms here, and delays a reaction by no more; urgent phases are also those in which "
    "there is most to learn from."
)
LISTS_NOTE = (
    "A list chooses and acts with every observation, and so has another transition to learn; the orderer may look "
    "and not act. What it gains by having less to learn is not gained by when it learns."
)
CONTROLS_NOTE = (
    f"{FORETOLD}: the preset deferred, told by a person which of the agent's own demons foretells an urgent phase, "
    f"and from which value on. {RANDOM}: what the orderer may decide, decided at random."
)

Groups = Mapping[tuple[str, str], Sequence[Row]]
"""The rows of a world and a schedule, in the order of their seeds."""


def find(pairs: Sequence[tuple[Cell, Row]], options: Options) -> Findings:
    """Compare the agent that orders its components itself with every fixed preset."""
    groups = grouped(pairs)
    claims = [claim for world in WORLDS for claim in _claims(groups, world)]
    tables = tuple(_table(groups, world) for world in WORLDS)
    return Findings(tuple(claims), figures(groups), tables, (SETTINGS_NOTE, CONTROLS_NOTE, LISTS_NOTE))


def grouped(pairs: Sequence[tuple[Cell, Row]]) -> Groups:
    """Return the rows by world and schedule, in the order of their seeds, so that they can be paired."""
    found: dict[tuple[str, str], list[tuple[int, Row]]] = defaultdict(list)
    for cell, row in pairs:
        found[cell["world"], cell["schedule"]].append((cell["seed"], row))
    return {group: [row for _, row in sorted(rows, key=lambda row: row[0])] for group, rows in found.items()}


def earned(rows: Sequence[Row], first: int = 0) -> NDArray[np.float64]:
    """Return what each run earned in the mean from a part on."""
    means: NDArray[np.float64] = np.array([row["earned"][first:] for row in rows]).mean(axis=1)
    return means


def _claims(groups: Groups, world: str) -> Iterator[Claim]:
    yield _against(
        groups, world, RIVALS, "than under any fixed preset on its one processor, its own learning included"
    )
    yield _against(groups, world, RIVALS, "than any of them in the second half, once it has learned", PARTS // 2)
    yield _against(groups, world, (SECOND_PROCESSOR,), "than background, which has a second processor")
    yield _against(groups, world, (FORETOLD,), "than deferred, told by a person what foretells urgency")
    yield _against(groups, world, (RANDOM,), "than at random: it is the learning that helps, not the freedom")
    yield _otherwise_when_urgent(groups, world)


def _against(groups: Groups, world: str, others: Sequence[str], said: str, first: int = 0) -> Claim:
    """Claim: it earns more than every one of some others, seed by seed."""
    ours = earned(groups[world, LEARNED], first)
    found = {name: paired(ours, earned(groups[world, name], first)) for name in others}
    return Claim(
        f"{world}: an agent that learns its own ordering earns more {said}.",
        PROPOSED,
        f"{interval(ours)} each {WORLDS[world].per}; more than "
        + "; ".join(f"{name} by {difference}" for name, difference in found.items()),
        all_of(above(difference) for difference in found.values()),
    )


def _otherwise_when_urgent(groups: Groups, world: str) -> Claim:
    """Claim: it learns less of the time while it is urgent (thesis, 3.5)."""
    calm, urgent = (_shares(groups[world, LEARNED], phase, "learn") for phase in ("calm", "urgent"))
    less = paired(calm, urgent)
    verdict = above(less)
    return Claim(
        f"{world}: it puts learning off while it is urgent, for when fast reactions are not required.",
        "suggests it (3.5), with no number",
        f"{_percent(interval(calm))} of calm time goes into learning, of urgent time {_percent(interval(urgent))}",
        verdict,
        "" if verdict is Verdict.REPRODUCED else IN_SLICES,
    )


def _shares(rows: Sequence[Row], phase: str, component: str) -> list[float]:
    return [row["shares"].get(phase, {}).get(component, 0.0) for row in rows]


def _percent(share: Interval) -> str:
    return f"{100 * share.middle:.0f} % [{100 * share.low:.0f}, {100 * share.high:.0f}]"


def _table(groups: Groups, world: str) -> Table:
    per = WORLDS[world].per
    head = ("schedule", f"reward each {per}", "second half", "reaction, median (ms)", "its p90 (ms)", "learned")
    rows = tuple(_row(name, groups[world, name]) for name in SCHEDULES)
    count = len(groups[world, LEARNED])
    return Table(f"{world}: means over {count} seeds with 95 % intervals.", head, rows)


def _row(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    def mean(values: Sequence[Any]) -> str:
        return f"{np.mean(values):.3g}"

    return (
        name,
        str(interval(earned(rows))),
        str(interval(earned(rows, PARTS // 2))),
        mean([row["reaction_ms"][1] for row in rows]),
        mean([row["reaction_ms"][2] for row in rows]),
        mean([row["learned"] for row in rows]),
    )
