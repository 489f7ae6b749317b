"""What the loop does for telemetry: it appends what happened in a cycle to a bounded buffer, and goes on."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from rtagent.agent import Agent
from rtagent.checkpoint.digest import digest_of
from rtagent.experience import Observation
from rtagent.learning import Horde, WithHorde
from rtagent.recorder import EpisodeRecord
from rtagent.telemetry.describing import about_demons
from rtagent.telemetry.predictions import Newest

Calls = Sequence[tuple[str, tuple[Any, ...]]]

NO_RECORD = ("component", "had_learned", "trial_began", "counted", "run_ended")
"""Calls that no record is made of, or only with others."""
STREAMS = {
    "chose": "choice", "acted": "action", "learned": "transition", "reacted": "reaction", "episode_began": "event",
    "episode_ended": "episode", "trial_ended": "event", "fault": "fault",
}  # fmt: skip
"""The streams that a call is one record of."""


LostTold = tuple[Mapping[str, int], Mapping[str, tuple[Any, Any, int]]]


Cycle = tuple[Calls, bytes | None, LostTold | None]
"""The calls of a cycle, the newest predictions where something was learned, and what was lost before it."""


class Collector:
    """An instrument that appends to `buffer` while fewer than `most` cycles wait there.

    `state` names the signals of the state. What found no room is counted by stream, and told with the next cycle.
    The run is told of `troubles`, sentences that others may append at any time. `make_room` is called where
    something has been appended (None: nothing is).
    """

    def __init__(self, state: Sequence[str], most: int, make_room: Callable[[], None] | None = None) -> None:
        self.buffer: deque[Cycle] = deque()
        self.troubles: list[str] = []
        self._state, self._most, self._make_room = list(state), most, make_room
        self._newest: Newest | None = None
        self._lost: Lost | None = None
        self._report: Callable[[str, str], None] | None = None
        self._counts: Callable[[], Mapping[str, int]] = dict
        self.loop: asyncio.AbstractEventLoop | None = None

    # Hooks

    def run_began(self, report: Callable[[str, str], None]) -> None:
        """Note where faults are to be told, and on which loop."""
        self._report, self.loop = report, asyncio.get_running_loop()

    def counting_began(self, counts: Callable[[], Mapping[str, int]]) -> None:
        """Note where counts are to be had."""
        self._counts = counts

    def trial_began(self, trial: int, agent: Agent) -> None:
        """Note whose predictions are told, and tell what they are about."""
        learner = agent.learner
        horde = learner.horde if isinstance(learner, WithHorde) else learner
        self._newest = newest = Newest(horde) if isinstance(horde, Horde) else None
        if isinstance(horde, Horde) and newest is not None:
            about = [msgspec.structs.astuple(each) for each in about_demons(horde, newest.places, self._state)]
            self._put([("trial_began", (trial, about, newest.places, newest.precision))])

    def noted(self, calls: Calls) -> None:
        """Append what happened in a cycle."""
        newest = None
        if self._newest is not None:
            for name, _ in calls:
                if name == "learned":
                    newest = self._newest()
                    break
        self._put(calls, newest)
        if self.troubles:
            self._tell_troubles()

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Append that an episode began."""
        self._put([("episode_began", (trial, episode, time))])

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Append what an episode came to."""
        seen = record.reactions
        counts = (seen.missed_reactions, seen.missed_responses, seen.anticipated)
        times = ([reaction.time for reaction in seen.reactions], list(seen.responses))
        ended = (record.trial, record.episode, record.began, record.ended, record.total_reward, record.steps)
        self._put([("episode_ended", (*ended, record.truncated, *times, *counts))])

    def trial_ended(self, trial: int, agent: Agent) -> None:
        """Append the digest of what was learned."""
        self._put([("trial_ended", (trial, digest_of(agent)))])

    def fault(self, source: str, message: str, time: int) -> None:
        """Append that something failed."""
        self._put([("fault", (source, message, time))])

    def count(self) -> None:
        """Append what was counted so far, where there is room; from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop counts something new meanwhile: there is a next time
            if len(self.buffer) < self._most:
                self.buffer.append(([("counted", (dict(self._counts()),))], None, None))

    def end(self, how: str) -> None:
        """Append what was counted, and how the run ended."""
        self._put([("counted", (dict(self._counts()),)), ("run_ended", (how,))])

    # The buffer

    def _put(self, calls: Calls, newest: bytes | None = None) -> None:
        if len(self.buffer) >= self._most:
            self._lost = self._lost or Lost()
            self._lost.add(calls, newest)
            return
        lost, self._lost = self._lost, None
        self.buffer.append((calls, newest, None if lost is None else lost.told()))
        if self._make_room is not None:
            self._make_room()

    def _tell_troubles(self) -> None:
        troubles, self.troubles[:] = list(self.troubles), []
        for sentence in troubles:
            if self._report is not None:
                self._report("telemetry", sentence)


class Lost:
    """What found no room in the buffer: how many records of each stream, and which samples of each device."""

    def __init__(self, before: LostTold | None = None) -> None:
        counts, samples = before or ({}, {})
        self._counts, self._samples = Counter(counts), dict(samples)

    def add(self, calls: Calls, newest: bytes | None) -> None:
        """Count the records that these calls would have become."""
        self._counts["components"] += any(name == "component" for name, _ in calls)
        self._counts["prediction"] += newest is not None
        for name, args in calls:
            if name == "observed":
                self._observed(*args)
            elif name not in NO_RECORD:
                self._counts[STREAMS[name]] += 1

    def _observed(self, observation: Observation, stimuli: Sequence[Any]) -> None:
        self._counts["observation"] += 1
        self._counts["stimulus"] += len(stimuli)
        for device, sample in observation.samples.items():
            this = (sample.sequence, sample.arrival_time)
            first, last, count = self._samples.get(device, (this, None, 0))
            self._samples[device] = (first, this, count + (this != last))

    def told(self) -> LostTold:
        """Return the counts by stream, but samples by device: the first, the last, and how many."""
        return +self._counts, self._samples
