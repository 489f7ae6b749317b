"""An emulated arm in a process of its own, on a pty: what the driver's tests drive."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rtagent_drivers.dynamixel.emulated.robots import ROBOTS
from rtagent_drivers.dynamixel.settings import Joint

NUMBERS = itertools.count()


class EmulatedArm:
    """An arm by the name of its robot; `tell` gives it orders, `joints` are those of a driver for it."""

    def __init__(self, folder: Path, robot: str = "bento", *arguments: str) -> None:
        self.port = str(folder / f"arm{next(NUMBERS)}")
        self.robot = robot
        command = [sys.executable, "-m", "rtagent_drivers.dynamixel.emulated.pty", robot, "--link", self.port]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [*command, "--linger", "0ms", *arguments], stdin=pipe, stdout=pipe, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == self.port

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def protocol(self) -> int:
        return next(iter(ROBOTS[self.robot]))

    def joints(self, **settings: Any) -> Mapping[str, Joint]:
        emulated = ROBOTS[self.robot][self.protocol]
        return {each.name: Joint(id=each.id, model=each.model, **settings) for each in emulated}

    def tell(self, **order: Any) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def fault(self, kind: str, servo: int = 0, **more: Any) -> None:
        self.tell(do="fault", kind=kind, servo=servo, **more)
        self.state()

    def mend(self) -> None:
        self.tell(do="mend")
        self.state()

    def state(self) -> Mapping[str, Mapping[str, Any]]:
        assert self._process.stdout is not None
        self.tell(do="tell")
        joints: Mapping[str, Mapping[str, Any]] = json.loads(self._process.stdout.readline())["joints"]
        return joints

    def __enter__(self) -> EmulatedArm:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        self._process.communicate(timeout=10)
