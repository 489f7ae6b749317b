"""Allocations a cycle: blocks of memory that each function takes, found between any two of its instructions.

`sys.getallocatedblocks` is read before and after each instruction of Python; what it grew by is the function's. So
a block counts that lives until the next instruction, however soon it is freed again. Objects that Python keeps for
reuse (its free lists: floats, small tuples, lists and dictionaries) take no block and are not counted, nor is what
numpy or another library takes elsewhere. Each function is named with the component that it worked for.
"""

from __future__ import annotations

import gc
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from rtagent.backlog import Inline
from rtagent.errors import SpecError, UndecidedError
from rtagent.latencies.counts import Counts
from rtagent.latencies.subject import Subject
from rtagent.runtime import Runtime
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE

SKIPPED, COUNTED = 23, 8
"""Cycles that fill caches and free lists, the last `SETTLING` of them traced already, and cycles that count."""

SETTLING = 3
BOUNDARY = Runtime._tell.__code__
"""What is called once a cycle, after the act."""

CYCLE = "cycle"
COMPONENTS: dict[CodeType, str] = {
    Runtime.go_on.__code__: CYCLE,
    Runtime._observe.__code__: OBSERVE,
    Runtime._choose.__code__: CHOOSE,
    Runtime._act.__code__: ACT,
    Runtime._learn.__code__: LEARN,
    Inline.learn.__code__: LEARN,
}
"""What begins, or goes on with, a component; what runs between them is the cycle's own."""

Place = tuple[str, CodeType]
"""A component, and a function."""

NOTE = "(blocks that live until the next instruction; the median of all cycles)"


def allocations(subject: Subject) -> Counts:
    """Run a subject once, slowly, and return the blocks that each function takes in a cycle, the median of cycles.

    Raises `SpecError` under the real clock, for which a traced run is too slow, and where something else traces
    already (a debugger, or coverage); `UndecidedError` where the run has too few cycles.
    """
    if subject.clock != "virtual":
        raise SpecError(f"{subject.name} runs under the real clock: allocations are counted under the virtual one.")
    if sys.gettrace() is not None:
        raise SpecError("allocations cannot be counted beside a debugger or coverage: run without (--no-cov).")
    counter = _Counter()
    with _without_collector():
        sys.settrace(counter.called)
        try:
            subject.run()
        finally:
            sys.settrace(None)
    cycles = counter.cycles[SKIPPED:]
    if len(cycles) < COUNTED:
        said = f"{subject.name} has only {len(counter.cycles)} cycles, and counting needs {SKIPPED + COUNTED}"
        raise UndecidedError(f"{said}: run more episodes.")
    return Counts("allocations", subject.name, _medians(cycles), NOTE)


def _medians(cycles: list[Counter[Place]]) -> dict[str, float]:
    found: Counter[str] = Counter()
    for place in set().union(*cycles):
        counts = sorted(cycle[place] for cycle in cycles)
        found[_name(place)] += counts[len(counts) // 2]
    return {name: count for name, count in sorted(found.items()) if count}


def _name(place: Place) -> str:
    """Return the name of a function, with its component's and its module's: in full where that is rtagent's."""
    component, code = place
    parts = Path(code.co_filename).with_suffix("").parts
    starts = [number for number, part in enumerate(parts) if part in ("rtagent", "rtagent_drivers")]
    return f"{component}: {'.'.join([*parts[starts[-1] if starts else -1 :], code.co_qualname])}"


@contextmanager
def _without_collector() -> Iterator[None]:
    """Collect no garbage meanwhile: it would empty free lists at moments of its own."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


class _Counter:
    """Traces every instruction. What it takes itself it has given back, or taken before it reads."""

    def __init__(self) -> None:
        self.cycles: list[Counter[Place]] = []
        self._cycle: Counter[Place] = Counter()
        self._component, self._code = CYCLE, BOUNDARY
        self._before = sys.getallocatedblocks()

    def called(self, frame: FrameType, event: str, arg: Any) -> Any:
        """Note a call, and trace what is called, once it is time to."""
        if frame.f_code is BOUNDARY:
            self._count_cycle()
        if len(self.cycles) < SKIPPED - SETTLING:
            return None
        self._note(frame.f_code)
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        self._before = sys.getallocatedblocks()
        return self.traced

    def traced(self, frame: FrameType, event: str, arg: Any) -> Any:
        """Note what the instruction before took."""
        self._note(frame.f_code)
        return self.traced

    def _count_cycle(self) -> None:
        self.cycles.append(self._cycle)
        self._cycle = Counter()
        if len(self.cycles) == SKIPPED + COUNTED:
            sys.settrace(None)

    def _note(self, code: CodeType) -> None:
        grown = sys.getallocatedblocks() - self._before
        if grown:
            if grown > 0:
                self._cycle[self._component, self._code] += grown
            self._before = sys.getallocatedblocks()
        if code is not self._code:
            self._component, self._code = COMPONENTS.get(code, self._component), code
