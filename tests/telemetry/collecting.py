"""Runs under the virtual clock whose telemetry is kept in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from parts import ROOT

from rtagent import clock
from rtagent.scenario import Assembly, assemble, load
from rtagent.telemetry.collect import Collector
from rtagent.telemetry.feeding import packed
from rtagent.telemetry.records import STREAM_OF, Record
from rtagent.telemetry.unpacking import Unpacker

HORDE = ROOT / "benchmarks" / "_telemetry.toml"
SHORT = ("run.clock=virtual", "run.episodes=3", "run.episode_steps=30")


def assembled(path: object = HORDE, overrides: Iterable[str] = SHORT) -> Assembly:
    return assemble(load(str(path), list(overrides)))


def collected(
    assembly: Assembly, keep: Callable[[int], bool] = bool, beside: Iterable[object] = ()
) -> tuple[dict[str, list[Record]], Unpacker]:
    """Run, and return the records of each stream; a cycle finds room only where `keep` says so of its number.

    The last, numbered -1, tells how the run ended, and what was lost before.
    """
    unpacker, found, puts = Unpacker(assembly.task.actions), dict[str, list[Record]](), iter(range(1, 10**9))

    class Picky(Collector):
        def _put(self, calls, newest=None):  # type: ignore[no-untyped-def]  # as the one that it stands before
            self._most = 1 if keep(next(puts)) else 0
            super()._put(calls, newest)

    def take() -> None:
        while collector.buffer:
            for record in unpacker(packed(collector.buffer.popleft())):
                found.setdefault(STREAM_OF[type(record)], []).append(record)

    collector = Picky(list(assembly.task.state), 1, take)
    clock.run(assembly.run([collector, *beside]), "virtual")
    puts = iter([-1])
    collector.end("done")
    return found, unpacker
