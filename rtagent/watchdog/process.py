"""The runtime's side of the watchdog: it starts the process, sends heartbeats, and hears what it did."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import Any

from rtagent.device import LastResort
from rtagent.errors import DeviceError
from rtagent.latch import Latch
from rtagent.units import describe, second

BEATS = 4
"""Heartbeats within the time-out."""
START_WITHIN = 10 * second
STOP_WITHIN = 6 * second
"""Somewhat longer than the watchdog waits for a device."""
END_WITHIN = 1 * second


class WatchdogProcess:
    """A watchdog that trips `latch` after `timeout` (ns) without a heartbeat, or once this process is gone.

    `told` is called with what it has done by itself. Its own death trips the latch too.
    """

    def __init__(self, timeout: int, scenario: str, latch: Latch, told: Callable[[str], None]) -> None:
        self._timeout, self._scenario, self._latch, self._told = timeout, scenario, latch, told
        self._loop = asyncio.get_running_loop()
        self._answer: asyncio.Future[dict[str, Any]] | None = None
        self._gone: asyncio.Future[None] = self._loop.create_future()
        self._beating: asyncio.TimerHandle | None = None
        self._one_question = asyncio.Lock()
        self._rest = b""
        self._ending = False
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rtagent.watchdog"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            pass_fds=[self._latch.fd],
            start_new_session=True,  # what a terminal sends to those in front of it does not reach it
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin.fileno(), self._process.stdout.fileno()

    async def start(self, resorts: Mapping[str, LastResort]) -> None:
        """Tell it what to do, and wait until it could; raise `DeviceError` where it cannot."""
        self._loop.add_reader(self._from, self._hear)
        self._send(json.dumps(self._order()).encode())
        await self.guard(resorts)
        os.set_blocking(self._to, False)
        self._beat()

    async def guard(self, resorts: Mapping[str, LastResort]) -> None:
        """Have it guard these, in place of those of before; raise `DeviceError` where it cannot."""
        told = {
            name: {"function": resort.function, "settings": dict(resort.settings), "hardware": resort.hardware}
            for name, resort in resorts.items()
        }
        answer = await self._ask(json.dumps(told).encode(), START_WITHIN)
        if "failed" in answer:
            raise DeviceError(
                f"the watchdog cannot reach the hardware, so nothing may move: {answer['failed']}. "
                "Check that nothing else holds its port."
            )

    async def make_safe(self) -> Mapping[str, list[str]]:
        """Have it make everything safe; return, by the names of devices, what is not."""
        found: Mapping[str, list[str]] = (await self._ask(b"stop", STOP_WITHIN))["not_safe"]
        return found

    async def end(self) -> None:
        """Send it away; nothing more is done by it."""
        self._ending = True
        if self._beating is not None:
            self._beating.cancel()
        self._send(b"end")
        _, late = await asyncio.wait({self._gone}, timeout=END_WITHIN / second)
        if late:
            self._process.kill()
        self._loop.remove_reader(self._from)
        with self._process:  # closes its pipes and waits for it
            pass

    def _order(self) -> dict[str, Any]:
        priority = os.sched_getparam(0).sched_priority if hasattr(os, "sched_getparam") else 0
        return {
            "latch": self._latch.fd,
            "timeout": self._timeout,
            "scenario": self._scenario,
            "priority": priority,
            "path": sys.path,  # whatever can be imported here can be imported there
        }

    async def _ask(self, line: bytes, within: int) -> dict[str, Any]:
        """Send a line and return the answer; raise `DeviceError` where there is none."""
        async with self._one_question:
            self._answer = self._loop.create_future()
            self._send(line)
            either: set[asyncio.Future[Any]] = {self._answer, self._gone}
            await asyncio.wait(either, timeout=within / second, return_when=asyncio.FIRST_COMPLETED)
        if self._answer.done():
            return self._answer.result()
        what = "its process has died" if self._gone.done() else f"it did not answer within {describe(within)}"
        raise DeviceError(f"there is no watchdog, so nothing may move: {what}.")

    def _beat(self) -> None:
        self._send(b"")
        self._beating = self._loop.call_later(self._timeout / BEATS / second, self._beat)

    def _send(self, line: bytes) -> None:
        with contextlib.suppress(BlockingIOError, BrokenPipeError):  # its silence is heard by `_hear`
            os.write(self._to, line + b"\n")

    def _hear(self) -> None:
        data = os.read(self._from, 1 << 16)
        if not data:
            self._died()
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(json.loads(line))

    def _take(self, message: dict[str, Any]) -> None:
        if "stopped" in message:
            self._latch.trip("watchdog", message["stopped"])
            self._told(message["not_safe"] or "the watchdog has made everything safe")
        elif self._answer is not None and not self._answer.done():
            self._answer.set_result(message)

    def _died(self) -> None:
        self._loop.remove_reader(self._from)
        if not self._gone.done():
            self._gone.set_result(None)
        if not self._ending:
            self._latch.trip("watchdog", "its process has died, and nothing moves without it")
