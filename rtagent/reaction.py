"""Reaction time: from a stimulus to the first action chosen from an observation that contains it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from rtagent.experience import Stimulus
from rtagent.saving import Saved


@dataclass(frozen=True, slots=True)
class Reaction:
    """The first action that was chosen from an observation containing a stimulus; times in ns.

    `sensing` is the age of the stimulus when it was observed, `deciding` lasts until act begins, `acting`
    until the action has been handed to the devices.
    """

    stimulus: Stimulus
    sensing: int
    deciding: int
    acting: int

    @property
    def time(self) -> int:
        """The reaction time."""
        return self.sensing + self.deciding + self.acting


@dataclass(slots=True)
class _Seen:
    """A stimulus in an observation; `chosen` once an action has been chosen from it."""

    stimulus: Stimulus
    observed: int
    chosen: bool = False
    reacted: bool = False


@dataclass
class EpisodeReactions:
    """What became of the stimuli of one episode; responses are times in ns.

    A stimulus without reaction, or without correct answer, when the episode ends is missed; one that was
    ended by a correct action chosen *before* it was seen is `anticipated` instead.
    """

    reactions: list[Reaction] = field(default_factory=list)
    responses: list[int] = field(default_factory=list)
    missed_reactions: int = 0
    missed_responses: int = 0
    anticipated: int = 0

    def save(self) -> Saved:
        """Return what became of them so far."""
        reactions = [[list(each.stimulus), each.sensing, each.deciding, each.acting] for each in self.reactions]
        return {**vars(self), "reactions": reactions, "responses": list(self.responses)}

    @classmethod
    def restored(cls, saved: Saved) -> EpisodeReactions:
        """Return what was saved."""
        reactions = [Reaction(Stimulus(*stimulus), *times) for stimulus, *times in saved["reactions"]]
        return cls(**{**saved, "reactions": reactions})


class ReactionTimer:
    """Follows each stimulus from its observation through the choice to the act.

    `answers(action, stimulus)` says which action is the correct answer.
    """

    def __init__(self, answers: Callable[[int, Stimulus], bool]) -> None:
        self._answers = answers
        self._waiting: list[_Seen] = []
        self._last_act: tuple[int, int] | None = None
        self.episode = EpisodeReactions()

    def begin(self) -> None:
        """Begin an episode."""
        self._waiting = []
        self._last_act = None
        self.episode = EpisodeReactions()

    def observed(self, stimuli: Sequence[Stimulus], time: int) -> None:
        """Take the stimuli that an observation made at `time` is the first to contain."""
        self._waiting.extend(_Seen(stimulus, time) for stimulus in stimuli)

    def chose(self) -> None:
        """Note that an action was chosen from the newest observation."""
        for seen in self._waiting:
            seen.chosen = True

    def acted(self, action: int, start: int, end: int) -> Sequence[Reaction]:
        """Note an act that lasted from `start` to `end` (ns); return the reactions that it was."""
        self._last_act = action, end
        if not self._waiting:
            return ()
        return self._settle(action, start, end)

    def _settle(self, action: int, start: int, end: int) -> list[Reaction]:
        new = [seen for seen in self._waiting if seen.chosen and not seen.reacted]
        reactions = [
            Reaction(seen.stimulus, seen.observed - seen.stimulus.time, start - seen.observed, end - start)
            for seen in new
        ]
        self.episode.reactions.extend(reactions)
        for seen in new:
            seen.reacted = True
        answered = [seen for seen in self._waiting if seen.chosen and self._answers(action, seen.stimulus)]
        self.episode.responses.extend(end - seen.stimulus.time for seen in answered)
        self._waiting = [seen for seen in self._waiting if seen not in answered]
        return reactions

    def end(self, unseen: Sequence[Stimulus]) -> EpisodeReactions:
        """End the episode, in which the `unseen` stimuli happened too; return what became of all."""
        open_ones = [(seen.stimulus, seen.reacted) for seen in self._waiting] + [(s, False) for s in unseen]
        for stimulus, reacted in open_ones:
            if not reacted and self._was_anticipated(stimulus):
                self.episode.anticipated += 1
                continue
            self.episode.missed_responses += 1
            self.episode.missed_reactions += not reacted
        self._waiting = []
        return self.episode

    def _was_anticipated(self, stimulus: Stimulus) -> bool:
        if self._last_act is None:
            return False
        action, end = self._last_act
        return end >= stimulus.time and self._answers(action, stimulus)

    def save(self) -> Saved:
        """Return the stimuli that wait, and the last act; what has become of others is the episode's."""
        waiting = [[list(seen.stimulus), seen.observed, seen.chosen, seen.reacted] for seen in self._waiting]
        return {"waiting": waiting, "last_act": self._last_act}

    def restore(self, saved: Saved, episode: EpisodeReactions) -> None:
        """Take what `save` returned in the middle of an episode; go on with what became of its stimuli."""
        self._waiting = [_Seen(Stimulus(*stimulus), *seen) for stimulus, *seen in saved["waiting"]]
        last = saved["last_act"]
        self._last_act, self.episode = None if last is None else (last[0], last[1]), episode
