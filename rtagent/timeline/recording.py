"""The instrument that keeps what a timeline shows: it only appends, and writes nothing while the run goes on."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

from rtagent.experience import Command, Observation, Stimulus
from rtagent.learn import Where
from rtagent.reaction import Reaction
from rtagent.recorder import EpisodeRecord
from rtagent.schedule import Component
from rtagent.timeline.rows import CAPACITY, Rows

MOST_FAULTS = 1000
MOST_LABELS = 1000
"""So many different names are kept; those that come later are all called `OTHER`."""

OTHER = "(other)"


class Kind(StrEnum):
    """What a row tells of. The comments say what its integers after the code are."""

    COMPONENT = "component"  # its start and end
    SLICE = "slice"  # the same, of learning
    ELSEWHERE = "elsewhere"  # the same, of learning beside the loop
    ACTION = "action"  # when it was handed to the devices, twice; the action
    SAMPLE = "sample"  # its world time, its arrival, its sequence number
    STIMULUS = "stimulus"  # its time, and when it was observed
    REACTION = "reaction"  # from the stimulus to the end of the act; when it was observed, when the act began


class Label(NamedTuple):
    """What the rows of one code are: their kind, and the name of the component, device or stimulus."""

    kind: Kind
    name: str


class FaultSeen(NamedTuple):
    """A fault, and when it was told (ns)."""

    source: str
    message: str
    time: int


class Timeline:
    """An instrument that keeps the newest `capacity` rows, each of 40 bytes; what it drops it counts."""

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.rows = Rows(capacity)
        self.labels: list[Label] = []
        self.episodes: list[EpisodeRecord] = []
        self.began: tuple[int, int, int] | None = None
        """Trial, episode and time (ns) of an episode that has not ended."""
        self.faults: deque[FaultSeen] = deque(maxlen=MOST_FAULTS)
        self.faults_told = 0
        self._codes: dict[Label, int] = {}
        self._newest: dict[str, tuple[int, int]] = {}
        self._components = {each: self._code(Kind.COMPONENT, each.value) for each in Component}

    @property
    def dropped(self) -> int:
        """How many rows and faults are not kept any more."""
        return self.rows.dropped + self.faults_told - len(self.faults)

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Keep where an episode begins."""
        self.began = trial, episode, time

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Keep an episode."""
        self.began = None
        self.episodes.append(record)

    def component(self, component: Component, start: int, end: int) -> None:
        """Keep when a component ran."""
        self.rows.append(self._components[component], start, end)

    def learned_for(self, start: int, end: int, where: Where) -> None:
        """Keep when was learned."""
        self.rows.append(self._code(Kind.SLICE if where is Where.LOOP else Kind.ELSEWHERE, "learn"), start, end)

    def acted(self, action: int, sent: Mapping[str, Command], start: int, end: int) -> None:
        """Keep which action is in force from when on."""
        self.rows.append(self._code(Kind.ACTION, "action"), end, end, action)

    def observed(self, observation: Observation, stimuli: Sequence[Stimulus]) -> None:
        """Keep the samples that are new, and the stimuli."""
        for device, sample in observation.samples.items():
            which = sample.sequence, sample.arrival_time  # numbers may begin anew with an episode
            if self._newest.get(device) != which:
                self._newest[device] = which
                code = self._code(Kind.SAMPLE, device)
                self.rows.append(code, sample.world_time, sample.arrival_time, sample.sequence)
        for stimulus in stimuli:
            self.rows.append(self._code(Kind.STIMULUS, stimulus.kind), stimulus.time, observation.time)

    def reacted(self, reaction: Reaction) -> None:
        """Keep a reaction and its parts."""
        begin = reaction.stimulus.time
        observed = begin + reaction.sensing
        code = self._code(Kind.REACTION, reaction.stimulus.kind)
        self.rows.append(code, begin, begin + reaction.time, observed, observed + reaction.deciding)

    def fault(self, source: str, message: str, time: int) -> None:
        """Keep a fault."""
        self.faults.append(FaultSeen(source, message, time))
        self.faults_told += 1

    def _code(self, kind: Kind, name: str) -> int:
        label = Label(kind, name)
        if label not in self._codes:
            if len(self.labels) >= MOST_LABELS and name != OTHER:
                return self._code(kind, OTHER)
            self._codes[label] = len(self.labels)
            self.labels.append(label)
        return self._codes[label]
