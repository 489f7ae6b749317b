"""A guarded device whose hardware is a file: each line says when (ns), who (process) and what."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from numpy.random import Generator

from rtagent import register
from rtagent.device import LastResort
from rtagent.errors import LimitError
from rtagent.experience import Command
from rtagent.specs import DeviceSpec
from rtagent_drivers.fake import FakeDevice, Faults
from rtagent_drivers.stopping import stopping_joint

HERE = Path(__file__).parent
SCENARIO = """
[run]
episodes = 50
episode_time = "10s"

[schedule]
preset = "reactive"
period = "5ms"

[watchdog]
timeout = "500ms"

[devices.joint]
driver = "guarded"
file = "{file}"

[task]
type = "stopping"

[features]
type = "tabular"

[learner]
type = "sarsa"

[policy]
type = "greedy"
"""


class Line(NamedTuple):
    time: int
    process: int
    what: str


def write(file: str, what: str) -> None:
    with Path(file).open("a") as hardware:
        hardware.write(f"{time.monotonic_ns()} {os.getpid()} {what}\n")


def lines(file: Path) -> list[Line]:
    """Return what happened so far, but for a line that is being written."""
    whole = file.read_text().rpartition("\n")[0].splitlines() if file.exists() else []
    return [Line(int(when), int(who), what) for when, who, what in (line.split(" ", 2) for line in whole)]


class Guarded(FakeDevice):
    """A joint that turns, and says so in a file with every command.

    It reaches its limit with the command of that number; where `jammed`, only the last resort can make it safe, and
    where `broken`, nothing can. It is gone for a while where `unplugged` says so.
    """

    def __init__(
        self,
        *,
        file: str,
        hardware: str = "",
        limit: int = 0,
        jammed: bool = False,
        broken: bool = False,
        unplugged: tuple[int, ...] = (),
    ) -> None:
        super().__init__(stopping_joint().world, faults=Faults(disconnect=(unplugged,) if unplugged else ()))
        self.file, self.limit, self.jammed, self.commands = file, limit, jammed or broken, 0
        self.resort = LastResort("guarded:spare", {"file": file, "broken": broken}, hardware or file)

    def last_resort(self) -> LastResort:
        return self.resort

    async def begin_episode(self, rng: Generator) -> None:
        write(self.file, "start")
        await super().begin_episode(rng)

    async def act(self, command: Command) -> Command:
        self.commands += 1
        if self.commands == self.limit:
            raise LimitError("the joint is at its limit: move it back by hand")
        write(self.file, "move")
        return await super().act(command)

    async def make_safe(self) -> None:
        if self.jammed:
            raise OSError("the driver is jammed")
        write(self.file, "safe")
        await super().make_safe()

    async def close(self) -> None:
        write(self.file, "closed")
        await super().close()


class Spare:
    def __init__(self, file: str, broken: bool) -> None:
        self.file, self.broken = file, broken
        write(file, "guarded")

    def make_safe(self) -> Sequence[str]:
        if self.broken:
            return ["its torque is still on: cut its power."]
        write(self.file, "safe by last resort")
        return []

    def close(self) -> None:
        write(self.file, "unguarded")


def spare(settings: Mapping[str, Any]) -> Spare:
    return Spare(**settings)


class Patient(Guarded):
    """One whose hardware stops by itself."""

    def __init__(self, *, file: str, tolerates: int = 0) -> None:
        super().__init__(file=file)
        self.tolerates = tolerates
        self.spec = DeviceSpec(self.spec.sensors, self.spec.actuators, rate=100.0)


register("drivers", "guarded", Guarded)
register("drivers", "patient", Patient)

if __name__ == "__main__":
    from rtagent.__main__ import main

    sys.modules["guarded"] = sys.modules["__main__"]
    sys.exit(main())
