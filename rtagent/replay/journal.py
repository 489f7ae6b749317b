"""An instrument that keeps in memory what a replay needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rtagent.agent import Agent
from rtagent.checkpoint.digest import digest_of
from rtagent.experience import Command, Observation, Stimulus, Transition
from rtagent.recorder import EpisodeRecord
from rtagent.replay.events import Acted, Began, Chose, Ended, Event, Knew, Learned, Observed


class Journal:
    """Keeps the `events` of a run."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self._progress = (0, 0)

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Keep it."""
        self.events.append(Began(trial, episode, time))

    def observed(self, observation: Observation, stimuli: Sequence[Stimulus]) -> None:
        """Keep it."""
        self.events.append(Observed(observation))

    def had_learned(self, transitions: int, pieces: int) -> None:
        """Remember it for the choice that follows."""
        self._progress = transitions, pieces

    def chose(self, action: int, probability: float, time: int) -> None:
        """Keep it."""
        self.events.append(Chose(action, probability, *self._progress))

    def acted(self, action: int, sent: Mapping[str, Command], start: int, end: int) -> None:
        """Keep it."""
        self.events.append(Acted())

    def learned(self, transition: Transition, delta: float, time: int) -> None:
        """Keep it."""
        self.events.append(Learned(delta))

    def trial_ended(self, trial: int, agent: Agent) -> None:
        """Keep the digest of what was learned."""
        self.events.append(Knew(digest_of(agent)))

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Keep it."""
        self.events.append(Ended())
