"""The instrument of every run: component times, sample ages, queue lengths, and what each episode came to."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from rtagent.reaction import EpisodeReactions
from rtagent.saving import Saved, restore_parts, save_parts
from rtagent.schedule import Component
from rtagent.series import Series

MOST_FAULTS = 100
"""So many different faults are listed; more are counted."""


@dataclass
class EpisodeRecord:
    """One episode: its reward, steps (transitions) and length (ns), and its reactions.

    One that a fault or a signal broke off is not `finished`; `ended` is then its last observation.
    """

    trial: int
    episode: int
    began: int
    ended: int = 0
    total_reward: float = 0.0
    steps: int = 0
    truncated: bool = False
    finished: bool = False
    reactions: EpisodeReactions = field(default_factory=EpisodeReactions)

    @property
    def duration(self) -> int:
        """How long it lasted, in ns."""
        return self.ended - self.began

    def save(self) -> Saved:
        """Return it as plain data."""
        return {**vars(self), "reactions": self.reactions.save()}

    @classmethod
    def restored(cls, saved: Saved) -> EpisodeRecord:
        """Return the episode that was saved."""
        return cls(**{**saved, "reactions": EpisodeReactions.restored(saved["reactions"])})


@dataclass
class Fault:
    """Something that failed: when first (ns since the run began), where, what, and how many times."""

    time: int
    source: str
    message: str
    fatal: bool = False
    traceback: str = ""
    count: int = 1


class Recorder:
    """Preallocated series of one run. `counters` counts everything dropped, retried, late."""

    def __init__(self) -> None:
        self.components = {component: Series() for component in Component}
        self.sample_age = Series()
        self.queue_length = Series()
        self.queue_age = Series()
        self.slices = Series()
        self.learning_time = 0
        self.elapsed = 0
        self.episodes: list[EpisodeRecord] = []
        self.faults: list[Fault] = []
        self.counters: Counter[str] = Counter()

    def fault(self, fault: Fault) -> None:
        """Keep a fault; the same sentence again only adds to its count."""
        for known in self.faults:
            if (known.source, known.message, known.fatal) == (fault.source, fault.message, fault.fatal):
                known.count += 1
                return
        if fault.fatal or len(self.faults) < MOST_FAULTS:
            self.faults.append(fault)
        else:
            self.counters["faults_not_listed"] += 1

    def save(self) -> Saved:
        """Return all that it has seen."""
        return {
            "series": save_parts(self._series()),
            "learning_time": self.learning_time,
            "episodes": [episode.save() for episode in self.episodes],
            "faults": [dict(vars(fault)) for fault in self.faults],
            "counters": dict(self.counters),
        }

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned."""
        restore_parts(self._series(), saved["series"])
        self.learning_time = saved["learning_time"]
        self.episodes[:] = [EpisodeRecord.restored(each) for each in saved["episodes"]]
        self.faults[:] = [Fault(**each) for each in saved["faults"]]
        self.counters.clear()
        self.counters.update(saved["counters"])

    def _series(self) -> dict[str, Series]:
        own = {name: series for name, series in vars(self).items() if isinstance(series, Series)}
        return own | {component.value: series for component, series in self.components.items()}
