"""A run as its checkpoints see it: what is captured of it, and how another run goes on from there."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rtagent.agent import Agent
from rtagent.checkpoint.keeper import Keeper, Report
from rtagent.checkpoint.resumed import Resumed, fitting
from rtagent.clock import Clock, VirtualClock
from rtagent.errors import CheckpointError, SpecError
from rtagent.recorder import Recorder
from rtagent.runtime import Habits, Runtime
from rtagent.saving import Saved
from rtagent.supervision import SupervisedDevice

if TYPE_CHECKING:
    from rtagent.lifecycle import Plan


class Keeping:
    """Keeps a run of `plan` by `keeper` (None: not at all): its devices, its recorder, the `agents` of its trials.

    `began` is when (ns) the run began, counted from where it went on.
    """

    def __init__(
        self,
        keeper: Keeper | None,
        plan: Plan,
        clock: Clock,
        recorder: Recorder,
        devices: Mapping[str, SupervisedDevice],
        agents: Sequence[Agent],
    ) -> None:
        self._keeper, self._plan, self._clock = keeper, plan, clock
        self._recorder, self._devices, self._agents = recorder, devices, agents
        self._ended_trials: list[Saved] = []
        self._resumed: Resumed | None = None
        self._runtime: Runtime | None = None
        self.began = clock.now()

    # Going on

    def begin(self, report: Report) -> None:
        """Go on from a checkpoint, if there is one; nothing is open yet. Raises `CheckpointError`."""
        keeper = self._keeper
        if keeper is None:
            return
        if keeper.resumed is not None:
            self._resumed = Resumed(keeper.resumed.saved, self._clock.virtual)
            if self._resumed.trial >= self._plan.trials:
                raise CheckpointError(
                    f"{keeper.path} is of trial {self._resumed.trial + 1}, and this run has {self._plan.trials}: "
                    "give it as many as before, or more."
                )
            with fitting():
                self._restore(self._resumed)
        keeper.begin(self, self._clock, report)

    def take_agent(self, agent: Agent, trial: int) -> None:
        """Restore the agent of a trial, if it was kept; raise `SpecError` where it could not be kept."""
        if self._keeper is None:
            return
        agent.save()  # tells what cannot be saved, and touches all of its memory, so that no cycle has to
        saved = self._resumed.agent(trial) if self._resumed else None
        if saved is not None:
            with fitting():
                agent.restore(saved)

    def is_over(self, trial: int) -> bool:
        """Say whether a trial was over when the checkpoint was kept."""
        return self._resumed is not None and trial < self._resumed.trial

    async def go_on(self, runtime: Runtime, trial: int) -> int:
        """Go on with a trial, and with the episode that is open; return which episode comes next."""
        self._runtime, resumed = runtime, self._resumed
        if resumed is None or trial != resumed.trial:
            return 0
        with fitting():
            runtime.restore(resumed.saved["runtime"])
        if resumed.open and resumed.exact:
            world = resumed.saved["world"]
            for name, device in self._devices.items():
                device.restore(world["devices"][name])
            runtime.restore_episode(world["episode"])
            await asyncio.sleep(0)  # what waits for samples begins to before the run does, as it had
            await runtime.go_on()
            await self.episode_ended(trial, resumed.episodes - 1)
        elif resumed.open:
            self._agents[-1].break_off()
        return resumed.episodes

    def _restore(self, resumed: Resumed) -> None:
        saved = resumed.saved
        self._recorder.restore(saved["recorder"])
        self._ended_trials = saved["agents"][: resumed.trial]
        if resumed.exact and isinstance(self._clock, VirtualClock):
            self._clock.go_on_from(saved["now"])
            for name, device in self._devices.items():
                device.restore_device(saved["world"]["devices"][name])
        self.began = self._clock.now() - saved["age"]

    # Keeping

    def habits(self, habits: Habits) -> Habits:
        """Return the habits of a run that is kept."""
        if self._keeper is None:
            return habits
        return Habits(_both(self._keeper.look, habits.calm), habits.place_learner)

    async def episode_ended(self, trial: int, episode: int) -> None:
        """Keep a checkpoint, if one is due."""
        if self._keeper is not None:
            last = (trial, episode) == (self._plan.trials - 1, self._plan.episodes - 1)
            await self._keeper.episode_ended(last)

    async def run_ended(self, *, broken_off: bool) -> None:
        """Keep what was learned in a run that was `broken_off`, if it is sound; see to it that all is written."""
        if self._keeper is None:
            return
        if broken_off and not self._clock.virtual and self._recorder.episodes:
            await self._keeper.keep_now(within_episode=not self._recorder.episodes[-1].finished)
        await self._keeper.written()

    # What the keeper asks

    @property
    def steps(self) -> int:
        """How many steps the run has made."""
        return sum(episode.steps for episode in self._recorder.episodes)

    @property
    def settled(self) -> bool:
        """Whether it can be captured in the middle of an episode now."""
        return self._runtime is not None and self._runtime.settled

    def unsettle(self) -> None:
        """Let learning go on."""
        if self._runtime is not None:
            self._runtime.work.unsettle()

    def learned_whole(self) -> bool:
        """Finish what is half learned, if that can be done now; say whether nothing is."""
        return self._runtime is not None and self._runtime.work.settle(wait=True)

    def capture(self, within_episode: bool) -> Saved:
        """Return all that is needed to go on from here; the world only under the virtual clock."""
        assert self._runtime is not None, "there is nothing to be kept before a run"
        newest, now = self._recorder.episodes[-1], self._clock.now()
        for ended in self._agents[len(self._ended_trials) : newest.trial]:
            self._ended_trials.append(ended.save())
        return {
            "place": {"trial": newest.trial, "episodes": newest.episode + 1, "open": within_episode},
            "now": now,
            "age": now - self.began,
            "recorder": self._recorder.save(),
            "agents": [*self._ended_trials, self._agents[newest.trial].save()],
            "runtime": self._runtime.save(),
            "world": self._save_world(self._runtime, within_episode) if self._clock.virtual else None,
        }

    def _save_world(self, runtime: Runtime, within_episode: bool) -> Saved | None:
        """Return the world, or None at the end of an episode where a device cannot be saved."""
        try:
            devices = {name: device.save() for name, device in self._devices.items()}
        except SpecError:
            if within_episode:
                raise
            return None
        return {"devices": devices, "episode": runtime.save_episode() if within_episode else None}


def _both(first: Callable[[], None], second: Callable[[], None] | None) -> Callable[[], None]:
    def calls() -> None:
        first()
        if second is not None:
            second()

    return calls
