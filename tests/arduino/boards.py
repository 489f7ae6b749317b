"""Emulated boards in processes of their own, on ptys, and the settings that fit them."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rtagent_drivers.arduino.layouts import HANDI_PINS, HANDI_SERVOS
from rtagent_drivers.arduino.settings import Channel, Servo

NUMBERS = itertools.count()

FINGERS: Mapping[str, Channel] = {f"finger{number}": Channel(f"A{number}") for number in range(6)}
HAND: Mapping[str, Channel] = {name.lower(): Channel(pin, inverted=pin == "2") for name, pin in HANDI_PINS.items()}
SERVOS: Mapping[str, Servo] = {f"digit{number}": Servo(pin) for number, pin in enumerate(HANDI_SERVOS)}


class Board:
    """An emulated board by its name; `tell` gives it orders, `log` is what it has done so far."""

    def __init__(self, folder: Path, name: str = "glovi", *arguments: str) -> None:
        self.port = str(folder / f"board{next(NUMBERS)}")
        self._log = Path(f"{self.port}.log")
        command = [sys.executable, "-m", "rtagent_drivers.arduino.emulated.pty", name, "--link", self.port]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(
            [*command, "--linger", "0ms", "--log", str(self._log), *arguments], stdin=pipe, stdout=pipe, text=True
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline().strip() == self.port

    def tell(self, do: str, **order: Any) -> None:
        """Give an order, and wait until it was done."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"do": do, **order}) + "\n" + '{"do": "tell"}\n')
        self._process.stdin.flush()
        self._process.stdout.readline()

    def fault(self, kind: str, **more: Any) -> None:
        self.tell("fault", kind=kind, **more)

    def log(self, what: str) -> list[dict[str, Any]]:
        lines = self._log.read_text().split("\n")[:-1]  # the last one may not be whole yet
        return [entry for line in lines if what in (entry := json.loads(line))]

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        self._process.communicate(timeout=10)
