"""When checkpoints are kept: looked at between cycles and at the ends of episodes, written beside the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rtagent.checkpoint.file import Checkpoint, write
from rtagent.clock import Clock
from rtagent.errors import RtagentError
from rtagent.saving import Saved
from rtagent.units import ms, second

NEVER = 1 << 62
PATIENCE, PAUSE = 1 * second, 1 * ms
"""At the end of an episode the learner's piece of work is waited for so long, and looked at so often."""

Report = Callable[[str, str], None]


@dataclass(frozen=True)
class Rules:
    """When a checkpoint is kept: `every` so often (ns), at the end of every so many `episodes`, after a `step`.

    Steps are those of the whole run; 0 is never. Another one is kept when the run ends.
    """

    every: int = 0
    episodes: int = 1
    step: int = 0


class Kept(Protocol):
    """A run as what keeps it sees it."""

    @property
    def steps(self) -> int:
        """How many steps (transitions) it has made."""

    @property
    def settled(self) -> bool:
        """Whether it can be captured within an episode now; learning may be held back until `unsettle`."""

    def unsettle(self) -> None:
        """Let learning go on."""

    def learned_whole(self) -> bool:
        """Finish what is half learned, if that can be done now; say whether nothing is."""

    def capture(self, within_episode: bool) -> Saved:
        """Return all that is needed to go on from here; raise `SpecError` where something cannot be saved."""


class Keeper:
    """Keeps the newest checkpoint of a run in a file; `about` tells of the run, which goes on from `resumed`."""

    def __init__(
        self,
        path: Path,
        rules: Rules = Rules(),  # frozen: sharing it changes nothing
        about: Mapping[str, Any] | None = None,
        resumed: Checkpoint | None = None,
    ) -> None:
        self.path, self.resumed = path, resumed
        self._rules, self._about = rules, about or {}
        self._writing: asyncio.Future[None] | None = None
        self.taken: list[int] = []
        """How long (ns) the loop was held up by each."""

    def begin(self, run: Kept, clock: Clock, report: Report) -> None:
        """Begin to look at a run; `report` is told, in sentences, of what could not be kept."""
        self._run, self._clock, self._report = run, clock, report
        self._step, self._episodes, self._failed = self._rules.step or NEVER, 0, False
        if run.steps >= self._step:
            self._step = NEVER
        self._put_off()

    def look(self) -> None:
        """Keep a checkpoint if one is due and nothing is in the way: for between two cycles."""
        if self._clock.now() < self._due and (self._step == NEVER or self._run.steps < self._step):
            return
        if self._writing is not None and not self._writing.done():
            return
        if self._run.settled:
            self._step = NEVER if self._run.steps >= self._step else self._step
            self._keep(within_episode=True)
        self._run.unsettle()

    async def episode_ended(self, last: bool) -> None:
        """Keep a checkpoint if one is due at the end of this episode, and in any case of the `last` one."""
        self._episodes += 1
        due = self._rules.episodes and self._episodes % self._rules.episodes == 0
        if last or due:
            await self.keep_now(within_episode=False)

    async def keep_now(self, within_episode: bool) -> None:
        """Keep a checkpoint when what is half learned is whole, and what is being written is written."""
        deadline = self._clock.now() + PATIENCE
        while not (whole := self._run.learned_whole()) and self._clock.now() < deadline:
            await self._clock.sleep_until(self._clock.now() + PAUSE)
        await self.written()
        if whole:
            self._keep(within_episode)
        self._run.unsettle()

    async def written(self) -> None:
        """Wait until nothing is being written."""
        if self._writing is not None:
            await asyncio.wait({self._writing})
            await asyncio.sleep(0)  # so that what failed is told

    def _keep(self, within_episode: bool) -> None:
        began = self._clock.now()
        self._put_off()
        if self._failed and within_episode:
            return
        try:
            saved = self._run.capture(within_episode)
        except RtagentError as error:
            self._failed = True
            where = " in the middle of an episode" if within_episode else ""
            self._report("checkpoint", f"no checkpoint is kept{where}: {error}")
            return
        self.taken.append(self._clock.now() - began)
        if self._clock.virtual:
            self._write(saved)
            return
        loop = asyncio.get_running_loop()
        self._writing = loop.run_in_executor(None, self._write, saved, loop.call_soon_threadsafe)

    def _write(self, saved: Saved, call: Callable[..., object] = lambda hook, *args: hook(*args)) -> None:
        """Write it, in whatever thread; what went wrong is told by a `call` on the loop."""
        try:
            write(self.path, self._about, saved)
        except RtagentError as error:
            call(self._report, "checkpoint", f"the checkpoint before stays, if there is one: {error}")

    def _put_off(self) -> None:
        self._due = self._clock.now() + self._rules.every if self._rules.every else NEVER
