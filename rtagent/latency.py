"""How late this machine wakes an event loop that sleeps: for a timer, and for an event from another process."""

from __future__ import annotations

import asyncio
import os
import struct
import subprocess
import sys
from collections import defaultdict
from collections.abc import Mapping

from rtagent import clock
from rtagent.realtime import Realtime, manners
from rtagent.summary import Summary
from rtagent.units import ms, second, us

NAP = 1 * ms
STAMP = struct.Struct("=q")
SENDER = "import sys; from rtagent.latency import send_events; send_events(int(sys.argv[1]))"
PATIENCE = 20 * second
"""So long the other process may take to start and to send."""

ROUNDS = 2


def measure(ways: Mapping[str, Realtime], duration: int) -> dict[str, dict[str, Summary]]:
    """Return by how much (ns) `sleep` and `event` were late in each of `ways`, watched for `duration` (ns) each.

    They take turns, so that what else the machine does meets them all. Raises `OSError` or `TimeoutError` where
    the other process does not send.
    """
    late: dict[str, dict[str, list[int]]] = {way: defaultdict(list) for way in ways}
    for _ in range(ROUNDS):
        for way, realtime in ways.items():
            with manners(realtime) as granted:
                late[way]["sleep"] += granted.run(sleeps(duration // (2 * ROUNDS)))
                late[way]["event"] += granted.run(events(duration // (2 * ROUNDS)))
    return {way: {kind: Summary.of(times) for kind, times in kinds.items()} for way, kinds in late.items()}


async def sleeps(duration: int) -> list[int]:
    """Return how late (ns) each of the sleeps of 1 ms ended that fit into `duration` (ns)."""
    time = clock.current()
    late = []
    for _ in range(duration // NAP):
        when = time.now() + NAP
        await time.sleep_until(when)
        late.append(time.now() - when)
    return late


async def events(duration: int) -> list[int]:
    """Return how long after another process had sent it (ns) each event of `duration` (ns) reached its handler."""
    command = [sys.executable, "-c", SENDER, str(duration)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as sender:  # noqa: S603, ASYNC220  # our own program
        assert sender.stdout is not None
        try:
            late = await _heard(sender.stdout.fileno())
        finally:
            sender.kill()
    if not late:
        raise OSError("the other process sent nothing")
    return late


async def _heard(pipe: int) -> list[int]:
    loop, now = asyncio.get_running_loop(), clock.current().now
    late: list[int] = []
    ended = loop.create_future()

    def arrived() -> None:
        data = os.read(pipe, 64 * STAMP.size)
        late.extend(now() - sent for (sent,) in STAMP.iter_unpack(data))
        if not data and not ended.done():
            ended.set_result(None)

    loop.add_reader(pipe, arrived)
    try:
        await asyncio.wait_for(ended, PATIENCE / second)
    finally:
        loop.remove_reader(pipe)
    return late


def send_events(duration: int) -> None:
    """Write the time to standard output, again and again at uneven intervals, for `duration` (ns)."""
    clock.run(_send(duration), "real")


async def _send(duration: int) -> None:
    time = clock.current()
    when, until, number = time.now() + NAP, time.now() + duration, 0
    while when < until:
        await time.sleep_until(when)
        os.write(sys.stdout.fileno(), STAMP.pack(time.now()))
        number += 1
        when += NAP + number * 619 % 1000 * us
