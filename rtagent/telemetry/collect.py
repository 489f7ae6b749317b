"""What the loop does for telemetry: it packs what happened in a cycle, once, into a bounded buffer, and goes on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from rtagent.agent import Agent
from rtagent.experience import Observation, Transition
from rtagent.learning import Horde, WithHorde
from rtagent.recorder import EpisodeRecord
from rtagent.telemetry.describing import about_demons
from rtagent.telemetry.packing import pack
from rtagent.telemetry.predictions import Newest

Calls = Sequence[tuple[str, tuple[Any, ...]]]

NO_RECORD = ("component", "trial_began", "run_ended")
SINGLE = {"chose": (), "acted": ("action",), "reacted": ("reaction",), "episode_ended": ("episode",)}
"""The streams that a call of a hook is one record of."""


class Collector:
    """An instrument that writes every cycle to a buffer: `write` says whether there was room.

    `state` names the signals of the state. What found no room is counted by stream, and told with what is written
    next. The run is told of `troubles`, sentences that others may append at any time.
    """

    def __init__(self, write: Callable[[bytes], bool], state: Sequence[str], troubles: list[str]) -> None:
        self._write, self._state, self.troubles = write, list(state), troubles
        self._newest: Newest | None = None
        self._lost = Lost()
        self._report: Callable[[str, str], None] | None = None

    # Hooks

    def run_began(self, report: Callable[[str, str], None]) -> None:
        """Note where faults are to be told."""
        self._report = report

    def trial_began(self, trial: int, agent: Agent) -> None:
        """Note whose predictions are told, and tell what they are about."""
        learner = agent.learner
        horde = learner.horde if isinstance(learner, WithHorde) else learner
        self._newest = Newest(horde) if isinstance(horde, Horde) else None
        if isinstance(horde, Horde) and self._newest is not None:
            places = sorted(self._newest.places)
            about = [msgspec.structs.astuple(each) for each in about_demons(horde, places, self._state)]
            self._put([("trial_began", (trial, about, self._newest.places, self._newest.precision))])

    def noted(self, calls: Calls) -> None:
        """Write what happened in a cycle."""
        self._put([(name, self._learned(*args)) if name == "learned" else (name, args) for name, args in calls])
        if self.troubles:
            self._tell_troubles()

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Write that an episode began."""
        self._put([("episode_began", (trial, episode, time))])

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Write what an episode came to."""
        seen = record.reactions
        counts = (seen.missed_reactions, seen.missed_responses, seen.anticipated)
        times = ([reaction.time for reaction in seen.reactions], seen.responses)
        ended = (record.trial, record.episode, record.began, record.ended, record.total_reward, record.steps)
        self._put([("episode_ended", (*ended, record.truncated, *times, *counts))])

    def fault(self, source: str, message: str, time: int) -> None:
        """Write that something failed."""
        self._put([("fault", (source, message, time))])

    def end(self, how: str) -> None:
        """Write how the run ended."""
        self._put([("run_ended", (how,))])

    # What is written

    def _learned(self, transition: Transition, delta: float, time: int) -> tuple[Any, ...]:
        t, newest = transition, self._newest
        return (
            t.action, t.next_action, t.probability, t.reward, t.elapsed, t.terminated, t.truncated,
            t.state, t.next_state, t.complete_at, delta, time, newest() if newest is not None else None,
        )  # fmt: skip

    def _put(self, calls: Calls) -> None:
        lost = self._lost
        if self._write(pack((lost.told() if lost.counts else None, calls))):
            if lost.counts:
                self._lost = Lost()
        else:
            lost.add(calls)

    def _tell_troubles(self) -> None:
        troubles, self.troubles[:] = list(self.troubles), []
        for sentence in troubles:
            if self._report is not None:
                self._report("telemetry", sentence)


class Lost:
    """What found no room in the buffer: how many records of each stream, and which samples of each device."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._samples: dict[str, tuple[Any, Any, int]] = {}

    def add(self, calls: Calls) -> None:
        """Count the records that these calls would have become."""
        names = [name for name, _ in calls]
        self.counts["components"] += "component" in names
        for name, args in calls:
            if name == "observed":
                self._observed(*args)
            elif name == "learned":
                self.counts["transition"] += 1
                self.counts["prediction"] += args[-1] is not None
            elif name == "episode_began":
                self.counts["event"] += 1
            elif name not in NO_RECORD:
                self.counts.update(SINGLE.get(name, (name,)))

    def _observed(self, observation: Observation, stimuli: Sequence[Any]) -> None:
        self.counts["observation"] += 1
        self.counts["stimulus"] += len(stimuli)
        for device, sample in observation.samples.items():
            this = (sample.sequence, sample.arrival_time)
            first, last, count = self._samples.get(device, (this, None, 0))
            self._samples[device] = (first, this, count + (this != last))

    def told(self) -> tuple[Mapping[str, int], Mapping[str, tuple[Any, Any, int]]]:
        """Return the counts by stream, but samples by device: the first, the last, and how many."""
        return +self.counts, self._samples
