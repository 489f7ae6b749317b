"""The result of a run: what its recorder saw, summarised, and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import groupby
from typing import Any

from rtagent.agent import Agent
from rtagent.errors import RtagentError
from rtagent.learning import Verified
from rtagent.learning.returns import PredictionErrors
from rtagent.recorder import EpisodeRecord, Fault, Recorder
from rtagent.schedule import Component, Schedule
from rtagent.series import Series
from rtagent.summary import Summary

POINTS = 100
"""So many values of a series are told."""

HOW_LEARNED = {
    "in place": "learned_in_place",
    "deferred": "learned_deferred",
    "under backpressure": "learned_under_backpressure",
    "shed": "transitions_shed",
}
"""What may become of a transition, in words, and the counter of it."""

LEARNING = "learning"
"""The source of faults of learning."""


class RunError(RtagentError):
    """A run that ended before its time, with its devices made safe; `result` is what it came to."""

    def __init__(self, message: str, result: Result) -> None:
        super().__init__(message)
        self.result = result

    @property
    def stopped(self) -> bool:
        """Whether somebody stopped it, by a signal, a key or `rtagent stop`."""
        return any(fault.fatal and fault.source == "stop" for fault in self.result.faults)


@dataclass(frozen=True)
class Learning:
    """How transitions were learned.

    The age of the oldest that waited, as seen at observations; the lengths of slices; which share of the time went
    into it; and what became of how many.
    """

    oldest_age: Summary
    slices: Summary
    share: float
    counts: Mapping[str, int]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data for JSON; times are in seconds."""
        counts = {HOW_LEARNED[how]: count for how, count in self.counts.items()}
        return {
            "oldest_age": self.oldest_age.in_seconds(),
            "slices": self.slices.in_seconds(),
            "share": self.share,
            **counts,
        }


@dataclass
class Result:
    """What a run came to. Times are in ns; `as_dict` gives seconds.

    `agents` are the agents of the trials, as they ended.
    """

    seed: int
    clock: str
    schedule: Schedule
    recorder: Recorder
    device_counters: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    agents: list[Agent] = field(default_factory=list)
    not_safe: list[str] = field(default_factory=list)

    @property
    def episodes(self) -> list[EpisodeRecord]:
        """All episodes, in order."""
        return self.recorder.episodes

    @property
    def faults(self) -> list[Fault]:
        """What failed, each sentence once with its first time."""
        return self.recorder.faults

    @property
    def learned_all(self) -> bool:
        """Whether learning neither failed nor left out a transition because its queue was full."""
        failed = any(fault.source == LEARNING for fault in self.faults)
        return not failed and not self.recorder.counters["transitions_shed"]

    @property
    def reaction_times(self) -> list[int]:
        """Every reaction time."""
        return [reaction.time for episode in self.episodes for reaction in episode.reactions.reactions]

    @property
    def response_times(self) -> list[int]:
        """Every response time: to the first correct answer."""
        return [time for episode in self.episodes for time in episode.reactions.responses]

    @property
    def reaction_time(self) -> Summary:
        """The reaction times, summarised."""
        missed = sum(episode.reactions.missed_reactions for episode in self.episodes)
        return Summary.of(self.reaction_times, missed=missed)

    @property
    def response_time(self) -> Summary:
        """The response times, summarised."""
        missed = sum(episode.reactions.missed_responses for episode in self.episodes)
        return Summary.of(self.response_times, missed=missed)

    @property
    def anticipated(self) -> int:
        """Stimuli that a correct action, chosen before they were seen, happened to answer."""
        return sum(episode.reactions.anticipated for episode in self.episodes)

    def reaction_parts(self) -> dict[str, Summary]:
        """Return the reaction times split into sensing, deciding and acting."""
        reactions = [reaction for episode in self.episodes for reaction in episode.reactions.reactions]
        return {
            part: Summary.of([getattr(reaction, part) for reaction in reactions])
            for part in ("sensing", "deciding", "acting")
        }

    def components(self) -> dict[str, Summary]:
        """Return the time of each component that ran."""
        return {
            component.value: _summary(series)
            for component, series in self.recorder.components.items()
            if series.count
        }

    def predictions(self, trial: int) -> Mapping[str, PredictionErrors]:
        """Return the errors of what the agent of a trial predicted, by the names of its demons."""
        learner = self.agents[trial].learner
        return learner.errors() if isinstance(learner, Verified) else {}

    def _learning_time(self) -> float:
        """Return how long (ns) was learned: in slices or elsewhere, and in one piece by the mean of those kept."""
        pieces = self.recorder.components[Component.LEARN]
        kept = pieces.values()
        return self.recorder.learning_time + (sum(kept) / len(kept) * pieces.count if kept else 0.0)

    def learning(self) -> Learning:
        """Return how transitions were learned."""
        recorder = self.recorder
        return Learning(
            _summary(recorder.queue_age),
            _summary(recorder.slices),
            self._learning_time() / recorder.elapsed if recorder.elapsed else 0.0,
            {how: recorder.counters[counter] for how, counter in HOW_LEARNED.items()},
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON; times are in seconds."""
        queue = _summary(self.recorder.queue_length)
        return {
            "seed": self.seed,
            "clock": self.clock,
            "schedule": _schedule_dict(self.schedule),
            "reaction_time": _with_missed(self.reaction_time)
            | {part: summary.in_seconds() for part, summary in self.reaction_parts().items()}
            | {"anticipated": self.anticipated},
            "response_time": _with_missed(self.response_time),
            "components": {name: summary.in_seconds() for name, summary in self.components().items()},
            "sample_age": _summary(self.recorder.sample_age).in_seconds(),
            "queue_length": {
                "median": queue.median,
                "max": queue.maximum,
                "over_time": _spread(self.recorder.queue_length.values()),
            },
            "learning": self.learning().as_dict(),
            "counters": dict(sorted(self.recorder.counters.items())),
            "devices": {name: dict(sorted(counts.items())) for name, counts in self.device_counters.items()},
            "faults": [_fault_dict(fault) for fault in self.faults],
            "not_safe": self.not_safe,
            "trials": [
                {
                    "trial": trial,
                    "episodes": [_episode_dict(episode) for episode in episodes],
                    "predictions": {name: asdict(errors) for name, errors in self.predictions(trial).items()},
                }
                for trial, episodes in groupby(self.episodes, key=lambda episode: episode.trial)
            ],
        }


def _spread(values: Sequence[int]) -> list[int]:
    """Return at most `POINTS` of the values, evenly spread."""
    places = range(0, len(values), max(1, -(-len(values) // POINTS)))
    return [values[place] for place in places]


def _summary(series: Series) -> Summary:
    return Summary.of(series.values(), count=series.count, maximum=series.maximum)


def _with_missed(summary: Summary) -> dict[str, Any]:
    return summary.in_seconds() | {"missed": summary.missed}


def _schedule_dict(schedule: Schedule) -> dict[str, Any]:
    return {
        "preset": schedule.name,
        "order": [component.value for component in schedule.order],
        "learn_delay_s": schedule.learn_delay / 1e9,
        "period_s": schedule.period / 1e9,
    }


def _fault_dict(fault: Fault) -> dict[str, Any]:
    return {
        "time_s": fault.time / 1e9,
        "source": fault.source,
        "message": fault.message,
        "fatal": fault.fatal,
        "count": fault.count,
    }


def _episode_dict(episode: EpisodeRecord) -> dict[str, Any]:
    return {
        "return": episode.total_reward,
        "steps": episode.steps,
        "duration_s": episode.duration / 1e9,
        "reactions_s": [reaction.time / 1e9 for reaction in episode.reactions.reactions],
        "responses_s": [time / 1e9 for time in episode.reactions.responses],
        "missed": episode.reactions.missed_responses,
        "anticipated": episode.reactions.anticipated,
        "truncated": episode.truncated,
        "finished": episode.finished,
    }
