"""The game: what the person's keys do, and what is drawn while the run goes on."""

from __future__ import annotations

import threading
from asyncio import AbstractEventLoop
from collections.abc import Callable
from typing import TextIO

from rtagent.clock.real import RealClock
from rtagent.experiments.egg.attempts import Judge
from rtagent.experiments.egg.conditions import CONTROL
from rtagent.keys import Key
from rtagent.latch import Latch
from rtagent.play import scene
from rtagent.recorder import EpisodeRecord

FRAME = 1 / 25
"""So often (s) the arm is drawn."""

ENDS = ("escape", "space", "s")
"""What ends the game: the keys that stop every run with real hardware."""

Press = Callable[[int], None]


class Game:
    """An instrument that goes with a run: it draws the arm from a thread, and tells how each attempt went.

    `hear` takes the keys, from any thread; a press counts while the arm moves, and is handed to `press` with its
    time (ns) on the loop of the run.
    """

    def __init__(self, judge: Judge, press: Press, key: str, latch: Latch, out: TextIO) -> None:
        self._judge, self._press, self._key, self._latch, self._out = judge, press, key, latch, out
        self._loop: AbstractEventLoop | None = None
        self._begun, self._over = threading.Event(), threading.Event()
        self._draws = out.isatty()
        self._speaking = threading.Lock()
        self._drawer = threading.Thread(target=self._draw, name="rtagent-game", daemon=True)

    # Before the run

    def introduce(self) -> None:
        """Tell what is to be done."""
        practice = sum(condition == CONTROL for condition in self._judge.conditions)
        self._say(scene.instructions(self._key, practice, len(self._judge.conditions) - practice))

    def wait(self) -> bool:
        """Wait until the person begins; say whether they do, or have ended the game."""
        self._begun.wait()
        return not self._latch.tripped

    def play_on(self, loop: AbstractEventLoop) -> None:
        """Have presses handed to a loop from now on, and draw."""
        self._loop = loop
        if self._draws:
            self._drawer.start()

    def close(self) -> None:
        """Draw no more."""
        self._over.set()
        if self._drawer.is_alive():
            self._drawer.join()

    # What the person does

    def hear(self, key: Key, time: int) -> None:
        """Take a key that came at `time` (ns)."""
        if key.name in ENDS and not key.control:
            self._latch.trip("keyboard", key.name)
            self._begun.set()
        elif key.name == self._key:
            self._pressed(time)

    def _pressed(self, time: int) -> None:
        loop, begun = self._loop, self._begun.is_set()
        self._begun.set()
        if begun and loop is not None and self._judge.moving:
            loop.call_soon_threadsafe(self._press, time)

    # What the run tells

    def episode_ended(self, record: EpisodeRecord) -> None:
        """Tell how it went; the judge has judged it before."""
        attempts = self._judge.attempts
        self._say(f"{scene.told(attempts[-1], len(attempts), len(self._judge.conditions))}\n")

    def _say(self, text: str) -> None:
        with self._speaking:
            self._out.write(f"\r\x1b[K{text}" if self._draws else text)
            self._out.flush()

    def _draw(self) -> None:
        while not self._over.wait(FRAME):
            self._say(scene.line(self._judge.gone(RealClock.now())))
