"""Counts a cycle, by name: they do not depend on the mood of a machine, so that one more fails at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

SHOWN = 8
"""So many names are told."""


@dataclass(frozen=True)
class Counts:
    """How often something happens in a cycle of a run, by the name of what does it."""

    what: str
    run: str
    per_cycle: Mapping[str, float]
    note: str = ""

    @property
    def total(self) -> float:
        """All of them, in a cycle."""
        return sum(self.per_cycle.values())

    def assert_at_most(self, limit: float) -> None:
        """Fail, by name, where there are more than `limit` in a cycle."""
        __tracebackhide__ = True
        if self.total > limit:
            most = sorted(self.per_cycle.items(), key=lambda item: -item[1])
            listed = [f"  {name}: {count:g}" for name, count in most[:SHOWN]]
            listed += [f"  and {len(most) - SHOWN} more"] if len(most) > SHOWN else []
            head = f"{self.run} has {self.total:g} {self.what} in a cycle, and {limit:g} are allowed:"
            raise AssertionError("\n".join([head, *listed, *filter(None, [self.note])]))

    def more_than(self, before: Counts | Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return what there is more of than `before`, by name: how many then, and how many now."""
        known = before.per_cycle if isinstance(before, Counts) else before
        return {
            name: (known.get(name, 0), count)
            for name, count in self.per_cycle.items()
            if count > known.get(name, 0)
        }

    def assert_no_more_than(self, before: Counts | Mapping[str, float]) -> None:
        """Fail where any name has more than it had `before`."""
        __tracebackhide__ = True
        more = self.more_than(before)
        if more:
            listed = [f"  {name}: {now:g}, and {then:g} before" for name, (then, now) in more.items()]
            head = f"{self.run} has more {self.what} in a cycle than before:"
            raise AssertionError("\n".join([head, *listed, *filter(None, [self.note])]))
