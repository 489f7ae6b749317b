"""The recorded observations through an agent: what it chooses, and what it learns."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from numpy.random import Generator

from rtagent.agent import Agent
from rtagent.checkpoint.digest import digest_of
from rtagent.errors import ReplayError, RtagentError
from rtagent.experience import Observation
from rtagent.learn import When, Where
from rtagent.replay.events import Acted, Began, Chose, Event, Knew, Learned, Observed
from rtagent.replay.learning import Learning, same
from rtagent.runtime import Limits
from rtagent.schedule import Schedule
from rtagent.streams import stream
from rtagent.task import Task, Urging


@dataclass
class Replayed:
    """What came of a replay: the agent of each trial, and how choices and errors compare with the recorded ones.

    `differs` is where (trial, episode, time in ns) the first other choice was made; `returns` are those of the
    episodes that ended. `deltas` counts the errors that were compared, `other_deltas` those that
    differ; `weights` and `other_weights` are trials.
    """

    agents: list[Agent] = field(default_factory=list)
    observations: int = 0
    choices: int = 0
    other_choices: int = 0
    differs: tuple[int, int, int] | None = None
    transitions: int = 0
    deltas: int = 0
    other_deltas: int = 0
    weights: int = 0
    other_weights: int = 0
    returns: list[float] = field(default_factory=list)
    failure: str = ""

    @property
    def same(self) -> bool:
        """Whether choices, errors of learning and final weights were the recorded ones."""
        return not (self.other_choices or self.other_deltas or self.other_weights)


@dataclass(frozen=True)
class Manner:
    """How a replay goes: `follows` the recorded actions, whatever the agent would choose, and learns `as_recorded`.

    Else it chooses by itself, and learns as its schedule says, as far as that needs no time.
    """

    follows: bool
    as_recorded: bool


def manner(schedule: Schedule, *, changed: bool) -> Manner:
    """Return how a recording is replayed: exactly, or, where the scenario was `changed`, by what was seen."""
    return Manner(follows=changed or schedule.learn.where is Where.THREAD, as_recorded=not changed)


class Replayer:
    """Replays what was recorded, through agents that `make_agent` makes from the random streams of `seed`."""

    def __init__(
        self,
        task: Task,
        make_agent: Callable[[Generator], Agent],
        schedule: Schedule,
        limits: Limits,
        seed: int,
        how: Manner,
    ) -> None:
        self._task, self._make_agent, self._schedule = task, make_agent, schedule
        self._limits, self._seed, self._how = limits, seed, how
        self._outcome = Replayed()
        self._learning: Learning | None = None
        self._recorded: list[float] = []
        self._digest = ""
        self._observation: Observation | None = None

    def replay(self, events: Iterable[Event]) -> Replayed:
        """Replay all of it; raise `ReplayError` where the recording does not fit."""
        for event in events:
            try:
                self._take(event)
            except ReplayError:
                raise
            except (RtagentError, LookupError) as error:
                raise ReplayError(
                    f"the recording does not fit the agent after {self._outcome.observations} observations: {error}"
                ) from error
        self._end_trial()
        return self._outcome

    def _take(self, event: Event) -> None:
        if self._learning is None and not isinstance(event, Began):
            raise ReplayError("the recording begins in the middle of an episode: only whole runs are replayed.")
        match event:
            case Began():
                self._begin(event)
            case Observed():
                self._observe(event.observation)
            case Chose():
                self._choose(event)
            case Acted():
                self._act()
            case Learned():
                self._recorded.append(event.delta)
            case Knew():
                self._digest = event.digest
            case _:
                self._end_episode()

    def _begin(self, event: Began) -> None:
        if event.trial >= len(self._outcome.agents):
            self._end_trial()
            self._begin_trial(event)
        self._episode = event
        self._steps, self._return = 0, 0.0
        self._task.begin()
        self._agent.begin()

    def _begin_trial(self, event: Began) -> None:
        trial = event.trial
        if trial != len(self._outcome.agents) or event.episode:
            raise ReplayError(
                f"the recording begins with episode {event.episode + 1} of trial {trial + 1}, as that of a run "
                "that went on from a checkpoint: only whole runs are replayed."
            )
        self._agent = self._make_agent(stream(self._seed, "policy", trial))
        self._agent.keeps_transitions = self._schedule.learns
        self._outcome.agents.append(self._agent)
        self._learning, self._recorded, self._digest = Learning(self._agent), [], ""

    def _observe(self, observation: Observation) -> None:
        outcome, time = self._task.interpret(observation), observation.time
        steps = self._steps + self._agent.step_is_open
        if not outcome.terminated and self._limits.reached(time - self._episode.time, steps):
            outcome = outcome._replace(truncated=True)
        self._return += outcome.reward
        self._steps += self._agent.observe(outcome, time) is not None
        self._observation = observation
        self._outcome.observations += 1

    def _choose(self, recorded: Chose) -> None:
        self._learn(recorded)
        agent, outcome = self._agent, self._outcome
        if self._how.follows:
            action = self._preferred()
            agent.follow(recorded.action, recorded.probability)
        else:
            action = agent.choose().action
        outcome.choices += 1
        if action is not None and action != recorded.action:
            outcome.other_choices += 1
            if outcome.differs is None and self._observation is not None:
                outcome.differs = (self._episode.trial, self._episode.episode, self._observation.time)

    def _preferred(self) -> int | None:
        """Return what the agent would choose, where what it knows at this moment is known."""
        agent, features = self._agent, self._agent.newest_features
        if self._how.as_recorded or agent.policy is None or features is None:
            return None
        values = agent.learner.action_values(features)  # type: ignore[union-attr]  # it controls: it has a policy
        return agent.policy.choose(values, agent.rng)[0]

    def _act(self) -> None:
        chosen = self._agent.chosen
        if chosen is None or chosen.action is None:
            raise ReplayError("the recording has an act before any choice: something of it is missing.")
        self._task.commands(chosen.action)
        self._agent.acted()

    def _learn(self, recorded: Chose) -> None:
        assert self._learning is not None, "a trial has begun"
        if self._how.as_recorded:
            self._learning.learn_until(recorded.learned, recorded.pieces)
        elif not self._waits():
            self._learning.learn_all()

    def _waits(self) -> bool:
        """Say whether the schedule leaves learning for later, as the newest observation is urgent."""
        calm, task, observation = self._schedule.learn.when is When.CALM, self._task, self._observation
        return calm and isinstance(task, Urging) and observation is not None and task.urgent(observation.samples)

    def _end_episode(self) -> None:
        self._outcome.returns.append(self._return)

    def _end_trial(self) -> None:
        """Learn what is left, and compare what was learned."""
        learning, outcome = self._learning, self._outcome
        if learning is None:
            return
        if self._how.as_recorded:
            learning.learn_until(len(self._recorded), 0)  # what a run that was stopped has left is not learned
            self._compare(learning)
        else:
            learning.learn_all()
        outcome.failure = outcome.failure or learning.failure
        outcome.transitions += len(learning.deltas)

    def _compare(self, learning: Learning) -> None:
        outcome, digest = self._outcome, self._digest
        pairs = zip(learning.deltas, self._recorded, strict=False)
        missing = max(0, len(self._recorded) - len(learning.deltas))
        outcome.deltas += len(self._recorded)
        outcome.other_deltas += sum(not same(*pair) for pair in pairs) + missing
        if digest:
            outcome.weights += 1
            outcome.other_weights += digest != digest_of(self._agent)
