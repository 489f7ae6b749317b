"""Sketches that run without a board: built by `make`, run by the simulator, told and watched from Python."""

from __future__ import annotations

import itertools
import json
import os
import queue
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import Any

FIRMWARE = Path(__file__).parent.parent
BUILD = FIRMWARE / "build"
PROCESSORS = {"uno": "atmega328p", "mega": "atmega2560"}
SERVO_PINS = {3: "E5", 5: "E3", 6: "H3", 9: "H6", 10: "B4", 11: "B5"}
"""Where a Mega has the pins that the hand's servos are on."""

BUTTON_PIN = "E4"
NUMBERS = itertools.count()


def missing() -> str:
    """Return what is not there to build and run sketches, or nothing."""
    tools = [tool for tool in ("make", "cc", "avr-gcc", "pkg-config") if shutil.which(tool) is None]
    files = [
        file
        for file in ("/usr/share/arduino/hardware/arduino/avr", "/usr/include/simavr", "/usr/include/libelf.h")
        if not Path(file).exists()
    ]
    return ", ".join(tools + files)


def build(*targets: str) -> None:
    """Build sketches ("hand-mega") and the simulator; raise RuntimeError with what the compiler says."""
    command = ["make", "-C", str(FIRMWARE), f"-j{os.cpu_count()}", f"BUILD={BUILD}", *targets]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  # our own sources
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)


class Simulated:
    """A board that runs a sketch, such as "hand-mega", under simavr. Times are the board's own, in ns."""

    def __init__(self, sketch: str, folder: Path, pins: Sequence[str] = (), *options: str) -> None:
        self.port = str(folder / f"simulated{next(NUMBERS)}")
        watching = [word for pin in pins for word in ("--watch", pin)]
        command = [str(BUILD / "simulator"), "--mcu", PROCESSORS[sketch.split("-")[1]], "--link", self.port]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(  # noqa: S603  # our own program
            [*command, *watching, *options, str(BUILD / f"{sketch}.elf")],
            stdin=pipe,
            stdout=pipe,
            text=True,
            bufsize=1,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"
        self._obeyed: queue.Queue[dict[str, Any]] = queue.Queue()
        self.pulses: list[dict[str, Any]] = []
        """What the pulses on the watched pins were, each time that they changed."""
        self._listener = Thread(target=self._listen, daemon=True)
        self._listener.start()

    def tell(self, order: str) -> int:
        """Give an order, such as "adc 3 512"; return the board's time at which it was obeyed."""
        self.order(order)
        return int(self._obeyed.get(timeout=10)["time"])

    def order(self, order: str) -> None:
        """Give an order, and leave its answer to the next one that waits."""
        assert self._process.stdin is not None
        self._process.stdin.write(order + "\n")

    def pulse(self, pin: int) -> float:
        """Return the pulses (µs; 0: none) that a servo of the hand gets now."""
        name = SERVO_PINS[pin]
        return next((float(each["pulse"]) for each in reversed(self.pulses) if each["pin"] == name), 0.0)

    def end(self) -> None:
        """End it."""
        self._process.terminate()
        self._listener.join(timeout=10)
        self._process.communicate(timeout=10)

    def __enter__(self) -> Simulated:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            said = json.loads(line)
            if "pin" in said:
                self.pulses.append(said)
            else:
                self._obeyed.put(said)
