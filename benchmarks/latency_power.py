"""Measures whether `rtagent bench --against` finds what it promises to find, and nothing else.

A session compares an agent with itself, in turns, by the functions and rules of the command: 12 rounds or more, in
pairs of processes. In some sessions one part of the second agent is a fifth slower, by work that it does more (the
age at observation by samples that are longer on their way); in others none is. How much more that has to be is
measured first. All is done once while the other processor has nothing to do, and once while it is busy.

A session should take some 13 s on a machine of its own, and there are 14 for each of `--sessions N` (20): an hour.
What others take of the processor makes it longer: rounds that they disturbed are measured anew; `--stolen SHARE`
says how much is too much (0.1). A session that is undecided has caught nothing. `--parts NAME…` leaves out others.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from math import nan
from pathlib import Path
from statistics import median

from _harness import Row, main
from _slowed import PARTS

from rtagent.errors import UndecidedError
from rtagent.latencies.comparing import BESIDE_LIMIT, BESIDE_ROUNDS
from rtagent.latencies.comparison import Comparison, Verdict
from rtagent.latencies.host import bound_to
from rtagent.latencies.processes import Command, beside, workers
from rtagent.latencies.rounds import Rules

SLOWER = 0.2
SESSIONS = 20
CAUGHT, ALARMS = 19 / 20, 1 / 20
"""So large a share of sessions has to catch a slowdown, and so large a share may see one that is not there."""

RUNS = 12
MUCH = dict.fromkeys(PARTS, 2000) | {"age of arm": 5_000_000}
"""Units of work, or ns of delay: so many runs with so much more say what it adds."""

BUSY = """
import os, time
parent, until = os.getppid(), time.monotonic() + 4 * 3600
while os.getppid() == parent and time.monotonic() < until:
    for _ in range(1_000_000):
        pass
"""
"""Keeps a processor busy, as long as somebody is there who wants it."""


def command(part: str, amount: int) -> Command:
    return [sys.executable, str(Path(__file__).with_name("_slowed.py")), part, str(amount)]


def amounts() -> dict[str, int]:
    """Return for each part how much more makes it a fifth slower."""
    return {part: _amount(part) for part in PARTS}


def _amount(part: str) -> int:
    """Return it by what `MUCH` more adds, each run beside one without."""
    with bound_to(None), workers(("main", command(part, 0)), ("slow", command(part, MUCH[part]))) as both:
        blocks = [[worker.times()[part] for worker in both] for _ in range(RUNS)][1:]
    without = median(median(block[0]) for block in blocks)
    added = median(median(block[1]) - median(block[0]) for block in blocks)
    return round(MUCH[part] * SLOWER * without / added)


@contextmanager
def busy() -> Iterator[None]:
    """Keep the first processor busy; it is measured on the last."""
    processors = sorted(os.sched_getaffinity(0))
    if len(processors) < 2:
        raise SystemExit("there is one processor only: no other can be busy.")
    with subprocess.Popen([sys.executable, "-c", BUSY]) as other:
        os.sched_setaffinity(other.pid, processors[:1])
        try:
            yield
        finally:
            other.kill()


def session(part: str, amount: int, stolen: float) -> Comparison | None:
    """Compare an agent with one of which a part does more; return nothing where that is undecided."""
    rules = Rules(rounds=BESIDE_ROUNDS, stolen=stolen)
    try:
        return beside(("main", command(part, 0)), ("mine", command(part, amount)), rules, BESIDE_LIMIT)[0]
    except UndecidedError:
        return None


def sessions(part: str, amount: int, options: argparse.Namespace) -> list[Comparison | None]:
    """Return so many sessions; each is told as soon as it is over."""
    found = []
    for _ in range(options.sessions):
        found.append(session(part, amount, options.stolen))
        said = "undecided" if found[-1] is None else f"slower: {', '.join(slower(found[-1])) or 'nothing'}"
        print(f"{part}, {amount} more: {said}", file=sys.stderr)
    return found


def slower(comparison: Comparison | None) -> list[str]:
    """Return what a session found to be slower."""
    ratios = comparison.ratios.values() if comparison else ()
    return [ratio.name for ratio in ratios if ratio.verdict(BESIDE_LIMIT) is Verdict.SLOWER]


def caught_rows(part: str, amount: int, load: str, options: argparse.Namespace) -> Iterator[Row]:
    found, n = sessions(part, amount, options), options.sessions
    caught = sum(part in slower(each) for each in found)
    yield Row(f"{part} a fifth slower, {load}: sessions of {n} that say so", caught, "", CAUGHT * n, "higher")
    seen = [each.ratios[part].ratio for each in found if each and part in each.ratios]
    yield Row("  as seen, median", median(seen) if seen else nan, "×")
    yield Row("  undecided", sum(each is None for each in found), "")


def alarm_rows(load: str, options: argparse.Namespace) -> Iterator[Row]:
    found, n = sessions("observe", 0, options), options.sessions
    alarms = [names for each in found if (names := slower(each))]
    which = f" ({', '.join(sorted({name for names in alarms for name in names}))})" if alarms else ""
    yield Row(f"nothing slower, {load}: sessions of {n} with an alarm{which}", len(alarms), "", ALARMS * n)
    yield Row("  undecided", sum(each is None for each in found), "")


def rows(options: argparse.Namespace) -> Iterator[Row]:
    more = amounts()
    for load, other in (("other processor idle", nullcontext), ("other processor busy", busy)):
        with other():
            yield from alarm_rows(load, options)
            for part in options.parts:
                yield from caught_rows(part, more[part], load, options)


def options_and_rest() -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--sessions", type=int, default=SESSIONS)
    parser.add_argument("--stolen", type=float, default=0.1)
    parser.add_argument("--parts", nargs="*", choices=list(PARTS), default=list(PARTS))
    return parser.parse_known_args()


if __name__ == "__main__":
    own, rest = options_and_rest()
    sys.exit(main(partial(rows, own), __doc__, rest))
