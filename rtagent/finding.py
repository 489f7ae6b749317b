"""What is found out about a machine and its hardware, and who finds it out: each problem comes with its cure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol


@dataclass(frozen=True)
class Finding:
    """One thing found; `essential`: with its problem rtagent cannot be relied upon to run."""

    name: str
    value: str
    problem: str = ""
    cure: str = ""
    essential: bool = False

    def but(self, wrong: object, problem: str, cure: str) -> Finding:
        """Return this finding, with a problem and its cure where something is wrong."""
        return replace(self, problem=problem, cure=cure) if wrong else self


@dataclass(frozen=True)
class Search:
    """How a port is looked at: `named`, the user has named it, so that it may be spoken to whatever it is.

    `ids` and `bauds` (bit/s) are those to look for on a bus, in this order; `mend` what can be mended.
    """

    named: bool = False
    ids: Sequence[int] = range(253)
    bauds: Sequence[int] = (1_000_000, 57_600)
    mend: bool = False


class Probe(Protocol):
    """A plug-in of the group `rtagent.probes`: finds out what is at the other end of a port."""

    async def __call__(self, port: str, search: Search) -> Sequence[Finding]:
        """Return what is found at `port`, a path. Nothing there may move."""
