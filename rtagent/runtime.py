"""The runtime: runs the components of an agent, in the order of its schedule, against its devices.

This is the only module that awaits components.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from numpy.random import Generator as RandomGenerator

from rtagent.agent import Agent
from rtagent.backlog import Backlog, Desk, Work, make_work, yield_once
from rtagent.clock import Clock
from rtagent.costs import Costs
from rtagent.errors import ScheduleError, SpecError
from rtagent.experience import Outcome, Transition
from rtagent.guard import NEVER
from rtagent.idling import Idling
from rtagent.instruments import Hooks
from rtagent.learn import Where
from rtagent.orderer import Orderer
from rtagent.ordering import Ordering
from rtagent.pacing import Pacer
from rtagent.reaction import ReactionTimer
from rtagent.recorder import EpisodeRecord, Recorder
from rtagent.saving import Saveable, Saved, save_fields
from rtagent.schedule import ACT, CHOOSE, LEARN, OBSERVE, ORDER, WAIT, Component, Order, Schedule, prologue
from rtagent.senses import Senses
from rtagent.situation import Present
from rtagent.streams import restored_stream, save_stream
from rtagent.supervision import SupervisedDevice
from rtagent.task import Task
from rtagent.urgency import Outlook, Urgency

EPISODE = ("_changed", "_latest", "_last_step")
"""What is saved of an episode as it is."""


@dataclass(frozen=True)
class Limits:
    """What truncates an episode: its length in ns and in steps (0: nothing does)."""

    episode_time: int = 0
    episode_steps: int = 0

    def reached(self, elapsed: int, steps: int) -> bool:
        """Say whether an episode of this length is to be truncated."""
        return bool(
            (self.episode_time and elapsed >= self.episode_time)
            or (self.episode_steps and steps >= self.episode_steps)
        )


@dataclass(frozen=True)
class Habits:
    """What is called for the sake of time: `calm` between cycles, `place_learner` by the thread of a learner."""

    calm: Callable[[], None] | None = None
    place_learner: Callable[[], None] | None = None


NO_HABITS = Habits()


def agent_prologue(schedule: Schedule, agent: Agent) -> Order:
    """Return what runs before the first cycle; raise `ScheduleError` where schedule and agent do not fit."""
    before = prologue(schedule.order, agent.learner.needs_next_action)
    if schedule.acts and agent.policy is None:
        raise ScheduleError(
            "the order has act and choose, but the agent has no policy: add one, or leave both out."
        )
    if agent.policy is not None and not schedule.acts:
        raise ScheduleError("the agent has a policy, but the order never chooses: leave one of them out.")
    controls = hasattr(agent.learner, "action_values")
    if schedule.acts and not controls:
        raise ScheduleError("this learner predicts, it values no actions: take one for control, such as sarsa.")
    if schedule.learns and controls and not schedule.acts:
        raise ScheduleError("this learner values actions, but the order never acts: take one that predicts, as td.")
    return before


class Runtime:
    """One agent with its devices, task and schedule, under the clock of the running loop."""

    def __init__(
        self,
        devices: Mapping[str, SupervisedDevice],
        task: Task,
        agent: Agent,
        schedule: Schedule,
        *,
        clock: Clock,
        recorder: Recorder,
        hooks: Hooks,
        costs: Costs,
        costs_rng: RandomGenerator,
        ordering_rng: RandomGenerator,
        limits: Limits,
        learning_failed: Callable[[BaseException], None],
        habits: Habits,
    ) -> None:
        self._devices, self._calm = devices, habits.calm
        self._task, self._agent, self._schedule = task, agent, schedule
        self._clock, self._now = clock, clock.now
        self._recorder, self._hooks, self._limits = recorder, hooks, limits
        self._heard = hooks.heard
        self._costs, self._costs_rng = (costs if clock.virtual else {}), costs_rng
        self._reactions = ReactionTimer(task.answers)
        self._prologue = agent_prologue(schedule, agent)
        self._components = {ACT: self._act, OBSERVE: self._observe, CHOOSE: self._choose}
        self._senses = Senses(tuple(devices.values()), schedule, clock, recorder)
        self._idling = Idling(tuple(devices.values()), clock, limits.episode_time) if clock.virtual else None
        self._record_component = {name: series.record for name, series in recorder.components.items()}
        self._record_queue_length = recorder.queue_length.record
        agent.keeps_transitions = schedule.learns
        self.work = self._make_work(habits, learning_failed)
        self._situation = Present(agent, self._senses, self.work, clock.now)
        self._in_one_piece = schedule.learn.where is Where.LOOP and not schedule.learn.slice
        self._components[LEARN] = self.work.learn if schedule.learn.inline else self._learn
        if self._idling:
            self._idling.learning = self.work.next_event
        self.orderer: Orderer | None = None
        if schedule.ordering is not None:
            self._begin_ordering(schedule.ordering, ordering_rng)

    def _make_work(self, habits: Habits, learning_failed: Callable[[BaseException], None]) -> Work:
        hooks, learn = self._hooks, self._schedule.learn
        desk = Desk(
            self._clock,
            self._recorder,
            self._learning_cost,
            self._newest,
            self._learned,
            learning_failed,
            costs=bool(self._schedule.learn_delay) or LEARN in self._costs,
            learned_for=self._learned_for if "learned_for" in hooks.heard else None,
        )
        return make_work(
            Backlog(self._agent, learn, desk),
            self._senses,
            Urgency(learn, self._task, self._agent, self._senses),
            virtual=self._clock.virtual,
            on_thread=habits.place_learner,
            once=self._schedule.ordering is not None,
        )

    def _begin_ordering(self, ordering: Ordering, rng: RandomGenerator) -> None:
        self.orderer = Orderer(ordering, rng)
        self._outlook = Outlook(ordering.urgency, self._task, self._agent, self._senses)
        self._never = asyncio.get_running_loop().create_future()
        self._components |= {LEARN: self._learn, ORDER: self._order, WAIT: self._wait}

    # The main path

    async def run_episode(self, trial: int, episode: int, rngs: Mapping[str, RandomGenerator]) -> EpisodeRecord:
        """Run one episode; `rngs` has a random stream for each device."""
        await self._begin(trial, episode, rngs)
        self._mark = self._now()
        for component in self._prologue:
            await self._components[component]()
        return await self.go_on()

    async def go_on(self) -> EpisodeRecord:
        """Run the rest of an episode, from between two of its cycles."""
        chooser = self.orderer or self._schedule.make_chooser()
        paced, calm = bool(self._schedule.period) or self._idling is not None, self._calm
        while not self._over:
            if paced:
                await self._wait_for_cycle()
            elif self._in_one_piece or not self.work.called:
                await yield_once()
            else:  # learning has left off after a round of the loop
                self.work.called = False
            self._mark = self._now()
            for component in chooser.cycle(self._situation):
                await self._components[component]()
                if self._over:
                    break
            if not self._schedule.acts:
                self._tell()
            if self.orderer is not None:
                await self.work.relieve()  # how much may wait is not for it to decide
                await yield_once()  # what it watches begins to be waited for before the next cycle is
            if calm is not None:
                calm()
        await self._end()
        return self._episode

    async def _begin(self, trial: int, episode: int, rngs: Mapping[str, RandomGenerator]) -> None:
        for device in self._devices.values():
            await device.go_to_start(rngs[device.name])
        now = self._now()
        for device in self._devices.values():
            device.begin_episode(now)
        self._task.begin()
        self._agent.begin()
        self._reactions.begin()
        self._episode = EpisodeRecord(trial, episode, now, now, reactions=self._reactions.episode)
        self._recorder.episodes.append(self._episode)
        self._over = self._changed = False
        self._latest = now + (self._limits.episode_time or NEVER)
        self._last_step = (self._limits.episode_steps or NEVER) - 1
        if self._idling:
            self._idling.begin(now)
        self._situation.episode = self._episode
        if self.orderer is not None:
            self._situation.urgency = (0.0,) * len(self.orderer.ordering.urgency)
            self.orderer.begin(now)
        self._pacer: Pacer | None = None
        self._hooks.call("episode_began", trial, episode, now)

    async def _end(self) -> None:
        """Learn what is left; a truncated episode still wants SARSA's A', which is chosen and not acted on."""
        if self.orderer is not None:
            self.orderer.end(self._situation, terminated=not self._episode.truncated)
        if self._agent.awaits_next_action:
            await self._choose()
        await self.work.learn()
        self._tell()
        now = self._now()
        unseen = [stimulus for device in self._devices.values() for stimulus in device.new_stimuli(until=now)]
        self._reactions.end(unseen)
        self._episode.finished = True
        if self._pacer:
            self._recorder.counters["overruns"] += self._pacer.overruns
            self._recorder.counters["skipped_periods"] += self._pacer.skipped
        self._hooks.call("episode_ended", self._episode)

    async def _wait_for_cycle(self) -> None:
        if self._pacer is not None:
            await self._clock.sleep_until(self._pacer.next(self._now()))
        elif self._schedule.period:
            self._pacer = Pacer(self._schedule.period, self._schedule.overrun, self._now())
        else:
            await yield_once()
        if self._idling is not None:
            would_learn = self.orderer is not None and self.work.length > 0
            settled = not self._changed and self._agent.repeats_action and not would_learn
            await self._idling.cycle_ended(settled)
            self._changed = False

    # The components

    async def _observe(self) -> None:
        observation, stimuli = await self._senses.observe()
        now = observation.time
        outcome = self._task.interpret(observation)
        if now >= self._latest or self._episode.steps >= self._last_step:
            outcome = self._limited(outcome, now)
        self._episode.total_reward += outcome.reward
        self._episode.ended = now
        if self._agent.observe(outcome, now) is not None:
            self._episode.steps += 1
        if self.orderer is not None:
            self._situation.urgency = self._outlook()
        if stimuli:
            self._reactions.observed(stimuli, now)
        if self._costs:
            await self._charge(OBSERVE)
        self._over = outcome.terminated or outcome.truncated
        self._episode.truncated = outcome.truncated
        self._done(OBSERVE)
        waiting = len(self._agent.queue) if self._in_one_piece else self.work.length
        self._record_queue_length(waiting)
        if waiting:
            self._recorder.queue_age.record(self.work.oldest_age(now))
        if "observed" in self._heard:
            self._hooks.note(("observed", (observation, stimuli)))

    async def _choose(self) -> None:
        if self._in_one_piece:
            decision = self._agent.choose()
        else:
            with self.work.weights:
                decision = self._agent.choose()
        if self._costs:
            await self._charge(CHOOSE)
        self._reactions.chose()
        end = self._done(CHOOSE)
        if "chose" in self._heard:
            if "had_learned" in self._heard:
                self._hooks.note(("had_learned", self.work.progress))
            self._hooks.note(("chose", (decision.action, decision.probability, end)))

    async def _act(self) -> None:
        start, decision, sent, delivered = self._mark, self._agent.chosen, {}, True
        if decision is None or decision.action is None:
            raise ScheduleError("act comes before anything was chosen: put observe and choose before it.")
        if self._costs:
            await self._charge(ACT)
        for name, command in self._task.commands(decision.action).items():
            taken = sent[name] = await self._devices[name].act(command)
            delivered = delivered and taken is not None
        end = self._done(ACT)
        if delivered:
            if self._idling is not None:
                self._changed = self._changed or not self._agent.repeats_action
            self._agent.acted()
            reactions = self._reactions.acted(decision.action, start, end)
            if "acted" in self._heard:
                self._hooks.note(("acted", (decision.action, sent, start, end)))
            if reactions and "reacted" in self._heard:
                for reaction in reactions:
                    self._hooks.note(("reacted", (reaction,)))
        self._tell()

    async def _learn(self) -> None:
        """Learn; what comes next in the cycle begins then."""
        await self.work.learn()
        self._mark = self._now()

    async def _order(self) -> None:
        """Charge the decision which component comes next; it has been made."""
        if self._costs:
            await self._charge(ORDER)
        self._done(ORDER)

    async def _wait(self) -> None:
        """Wait for something new to observe, for as long as the ordering may."""
        assert self._schedule.ordering is not None, "no list waits"
        await self._senses.wait_for_news(self._never, self._schedule.ordering.wait)
        self._done(WAIT)

    async def drain(self, deadline: int | None) -> None:
        """Learn what is left after the last episode, until `deadline` (ns; None: all of it)."""
        self._mark = self._now()
        await self.work.drain(deadline)
        self._tell()

    # What a checkpoint keeps: `calm` is called where it can be saved

    @property
    def settled(self) -> bool:
        """Whether an episode is between two of its cycles, no device fails, and nothing is half learned."""
        return (
            not self._over and all(device.settled for device in self._devices.values()) and self.work.settle(False)
        )

    def save(self) -> Saved:
        """Return what is being learned, what was learned of ordering, and the random state of costs."""
        ordering = None if self.orderer is None else self.orderer.save()
        return {"work": self.work.save(), "costs": save_stream(self._costs_rng), "ordering": ordering}

    def restore(self, saved: Saved) -> None:
        """Take what `save` returned; the newest episode of the recorder is the last one, or goes on."""
        self._episode = self._situation.episode = self._recorder.episodes[-1]
        self._costs_rng = restored_stream(saved["costs"])
        self.work.restore(saved["work"])
        if self.orderer is not None and saved.get("ordering") is not None:
            self.orderer.restore(saved["ordering"])
        if saved["work"]["failed"]:
            self._agent.keeps_transitions = False

    def save_episode(self) -> Saved:
        """Return what it is at in an episode; raise `SpecError` where the task or the chooser cannot be saved."""
        if not isinstance(self._task, Saveable) or self._schedule.chooser is not None:
            what = self._schedule.chooser or type(self._task).__name__
            raise SpecError(
                f"{what} cannot be saved in the middle of an episode: give it save and restore "
                "(docs/checkpoints.md), or keep checkpoints at the ends of episodes only."
            )
        return save_fields(self, EPISODE) | {
            "urgency": list(self._situation.urgency),
            "task": self._task.save(),
            "idling": self._idling.save() if self._idling else None,
            "pacer": self._pacer.save() if self._pacer else None,
            "reactions": self._reactions.save(),
        }

    def restore_episode(self, saved: Saved) -> None:
        """Take what `save_episode` returned."""
        self._over = False
        self._changed, self._latest, self._last_step = (saved[name] for name in EPISODE)
        self._situation.urgency = tuple(saved["urgency"])
        self._task.restore(saved["task"])  # type: ignore[attr-defined]  # what could be saved can be restored
        self._reactions.restore(saved["reactions"], self._episode.reactions)
        if self._idling is not None:
            self._idling.restore(saved["idling"])
        self._pacer = None
        if saved["pacer"] is not None:
            self._pacer = Pacer(self._schedule.period, self._schedule.overrun, 0)
            self._pacer.restore(saved["pacer"])

    # What learning asks and tells

    def _newest(self) -> int:
        """Return when the newest observation was made, in ns."""
        return self._episode.ended

    def _learning_cost(self) -> int:
        """Return what the transition that is about to be learned is said to cost, in ns."""
        cost = self._costs.get(LEARN)
        return self._schedule.learn_delay + (cost.draw(self._costs_rng) if cost is not None else 0)

    def _learned(self, transition: Transition, delta: float) -> None:
        end = self._done(LEARN) if self._in_one_piece else self._now()
        if "learned" in self._heard:
            self._hooks.note(("learned", (transition, delta, end)))

    def _learned_for(self, start: int, end: int, where: Where) -> None:
        self._hooks.note(("learned_for", (start, end, where)))

    def _done(self, component: Component) -> int:
        """Note that a component has ended; it began where the last one did, or the cycle."""
        start, end = self._mark, self._now()
        self._record_component[component](end - start)
        if "component" in self._heard:
            self._hooks.note(("component", (component, start, end)))
        self._mark = end
        return end

    def _tell(self) -> None:
        """Call the hooks for all that was noted: never between an observation and its action."""
        if self._hooks.noted:
            self._hooks.tell()
            self._mark = self._now()

    async def _charge(self, component: Component) -> None:
        cost = self._costs.get(component)
        if cost is not None:
            await self._clock.charge(cost.draw(self._costs_rng))

    def _limited(self, outcome: Outcome, now: int) -> Outcome:
        if outcome.terminated or outcome.truncated:
            return outcome
        if self._limits.reached(now - self._episode.began, self._episode.steps + self._agent.step_is_open):
            return outcome._replace(truncated=True)
        return outcome
