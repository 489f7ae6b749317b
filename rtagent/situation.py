"""The situation of a run, as a chooser sees it."""

from __future__ import annotations

from collections.abc import Callable

from rtagent.agent import Agent
from rtagent.backlog import Work
from rtagent.recorder import EpisodeRecord
from rtagent.senses import Senses


class Present:
    """What a chooser can ask, also one that learns (`schedule.Situation`, `orderer.Surroundings`).

    All of it is known without waiting. The run sets the `episode`, and how urgent its newest observation is.
    """

    episode: EpisodeRecord

    def __init__(self, agent: Agent, senses: Senses, work: Work, now: Callable[[], int]) -> None:
        self._agent, self._senses, self._work, self._now = agent, senses, work, now
        self.urgency: tuple[float, ...] = ()

    @property
    def time(self) -> int:
        """Now, in ns."""
        return self._now()

    @property
    def observed_at(self) -> int:
        """When the newest observation was made, in ns."""
        return self.episode.ended

    @property
    def queue_length(self) -> int:
        """How many transitions wait to be learned."""
        return self._work.length

    @property
    def action_pending(self) -> bool:
        """Whether an action was chosen that was not yet handed to the devices."""
        return self._agent.action_pending

    @property
    def reward(self) -> float:
        """The task's reward of the episode so far."""
        return self.episode.total_reward

    @property
    def has_observed(self) -> bool:
        """Whether the episode has had an observation."""
        return self._agent.newest_features is not None

    @property
    def fresh(self) -> bool:
        """Whether there is an observation newer than the last choice."""
        return self._agent.fresh

    @property
    def change(self) -> bool:
        """Whether that observation differs, in its features, from the one that was chosen from last."""
        return self._agent.sees_change

    @property
    def news(self) -> bool:
        """Whether a sample waits that is newer than the newest observation."""
        self._senses.watch()
        return self._senses.news()

    @property
    def observable(self) -> bool:
        """Whether an observation would tell anything newer without waiting for it."""
        senses, acted = self._senses, self._agent.step_is_open
        if (senses.synchronous and acted) or (senses.as_of_now and (acted or self._now() > self.observed_at)):
            return True
        return self.news
