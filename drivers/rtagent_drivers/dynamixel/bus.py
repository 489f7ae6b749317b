"""A half-duplex bus: one owner of the line, a small state machine driven by what is received and by one timer.

At most one exchange is on the line. When its last byte has come, or its deadline has passed, the next request is
sent in the same callback, before anybody hears of the answers: no task is waited for, and nothing spins.
"""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from rtagent.clock import current
from rtagent.errors import DeviceError, DisconnectedError
from rtagent.units import describe, ms, us
from rtagent_drivers.dynamixel.exchange import Exchange, Question, Statuses, question
from rtagent_drivers.dynamixel.packets import Codec, Request, Status
from rtagent_drivers.dynamixel.polling import TICK, Polling, Roster, Round
from rtagent_drivers.dynamixel.timing import transaction, wire
from rtagent_drivers.serial_line import Connect, Line, connect

PATIENCE = 10 * ms
"""How much later than the wire allows an answer may be: adapters, kernel, a processor that is busy elsewhere."""

HURRY = 7 * ms
"""So much less patience there is while a stop is tried again and again."""

STANDSTILL = 20 * ms
"""Longer than what is on the line may take, and by so much, no command waits but where the loop stands still."""

DEFAULT_RETURN_DELAY = 500 * us


class _Write(NamedTuple):
    data: bytes
    sent: asyncio.Future[bool]
    asked: int


class Bus:
    """The owner of a line. All times are in ns; all methods belong to the event loop that opened it."""

    def __init__(
        self, codec: Codec, port: str, baud: int, patience: int = PATIENCE, connect: Connect = connect
    ) -> None:
        self.codec, self.port, self.baud, self.patience = codec, port, baud, patience
        self._connect = connect
        self.return_delay = DEFAULT_RETURN_DELAY
        self._counts: Counter[str] = Counter()
        self._decoder = codec.status_decoder()
        self._line: Line | None = None
        self._polling: Polling | None = None
        self._lost: Callable[[DisconnectedError], None] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._clear()

    def _clear(self) -> None:
        self._exchange: Exchange | None = None
        self._deadline = self._wakes_at = self._free_at = 0
        self._urgent: deque[Exchange] = deque()
        self._asked: deque[Exchange] = deque()
        self._answers: set[asyncio.Future[Statuses]] = set()
        self._writes: dict[str, _Write] = {}

    async def open(self) -> str:
        """Open the line; return the path of its port. Raises `DisconnectedError`."""
        self._loop, self._now = asyncio.get_running_loop(), current().now
        self._decoder.reset()
        self._line = await self._connect(self.port, self.baud, self)
        return self._line.path

    async def close(self) -> None:
        """Give up what is under way, and close the line."""
        line = self._line
        self._lost = None
        self._give_up(DisconnectedError("the bus is closed: open it first."))
        if line is not None:
            await line.close()

    @property
    def counters(self) -> Mapping[str, int]:
        """Answers that were missing, damaged or unexpected, and what was asked again."""
        damaged = {"packets_damaged": self._decoder.damaged, "bytes_skipped": self._decoder.skipped}
        return self._counts + Counter(damaged)

    # What is asked of it

    async def transact(self, request: Request, expected: dict[int, int], retries: int = 0) -> Mapping[int, Status]:
        """Send a request; return the answers by servo, without those that did not come.

        `expected` has how many bytes each servo answers, in the order of the answers. While some are missing it is
        asked again, `retries` times at most. Raises `DisconnectedError`.
        """
        asked = question(self.codec, expected, request)
        statuses = await self._ask(asked)
        for _ in range(retries):
            if len(statuses) == len(expected):
                break
            self._counts["requests_repeated"] += 1
            statuses |= await self._ask(asked)
        return statuses

    async def send(self, key: str, *requests: Request) -> bool:
        """Send requests that nobody answers as soon as the line is free; return when they were handed over.

        They take the place of those of the same `key` that still wait; for these False is returned. Raises
        `DeviceError` where an emergency overtook it, or it waited for too long, and `DisconnectedError`.
        """
        self._check_open()
        waiting = _Write(b"".join(map(self.codec.request, requests)), self._loop.create_future(), self._now())
        before = self._writes.pop(key, None)
        if before is not None and not before.sent.done():
            before.sent.set_result(False)
        self._writes[key] = waiting
        self._go_on()
        return await waiting.sent

    async def emergency(self, writes: Sequence[Request], asked: Sequence[Question]) -> Mapping[int, Status]:
        """Send `writes` and what is `asked` before everything else, and return the answers that came.

        With each question the writes go out again: on a bad line the more often, the better.
        Commands that wait are dropped. What is on the line is waited for only as long as its answers may take by
        the wire, and not at all where garbage comes.
        """
        self._drop_writes(DeviceError("a stop overtook the command, which was not sent."))
        written = b"".join(map(self.codec.request, writes))
        answers = [self._ask(replace(each, data=written + each.data), urgent=True) for each in asked]
        statuses: dict[int, Status] = {}
        for answer in answers:
            statuses |= await answer
        return statuses

    def poll(
        self,
        roster: Roster,
        period: int,
        hear: Callable[[Round], None],
        lost: Callable[[DisconnectedError], None],
    ) -> None:
        """Ask the questions of `roster` in rounds, `period` apart, or as fast as the line goes; tell the answers.

        `lost` is told if the line goes away.
        """
        self._check_open()
        self._polling, self._lost = Polling(roster, period, hear, self._now()), lost
        self._go_on()

    # What the line tells

    def data_received(self, data: bytes, /) -> None:
        """Take bytes; where they end an exchange, send what comes next."""
        exchange = self._exchange
        for status in self._decoder.feed(data):
            if exchange is None or not exchange.take(status):
                self._counts["answers_unexpected"] += 1
        if exchange is not None and (exchange.over or (self._urgent and self._in_the_way(exchange))):
            self._end(exchange)

    def connection_lost(self, error: DisconnectedError | None, /) -> None:
        """Hear that the line has gone."""
        self._give_up(error or DisconnectedError(f"{self.port} was closed: open it first."))

    # The state machine

    def _ask(self, asked: Question, *, urgent: bool = False) -> asyncio.Future[Statuses]:
        self._check_open()
        answers: asyncio.Future[Statuses] = self._loop.create_future()
        self._answers.add(answers)
        answers.add_done_callback(self._answers.discard)
        (self._urgent if urgent else self._asked).append(Exchange(asked, _settle(answers), urgent))
        if urgent and self._exchange is not None:
            self._make_way(self._exchange)
        self._go_on()
        return answers

    def _make_way(self, exchange: Exchange) -> None:
        """Let what is on the line end as soon as the line can be free."""
        if exchange.urgent:
            return
        if self._in_the_way(exchange):
            self._end(exchange)
        else:
            self._deadline = min(self._deadline, exchange.until)
            self._arm()

    def _in_the_way(self, exchange: Exchange) -> bool:
        """Say whether nothing good is to be expected of what is on the line: it is late, or garbage came."""
        return not exchange.urgent and (self._garbage() > exchange.garbage or self._now() >= exchange.until)

    def _go_on(self) -> None:
        """Send what is to be sent next, if the line is free."""
        if self._exchange is not None or self._line is None:
            return
        now = self._now()
        if self._writes:
            self._drop_old_writes(now)
        exchange = self._next(now)
        if exchange is None and not self._writes:
            self._arm()
            return
        self._exchange = exchange
        writes, self._writes = self._writes, {}
        data = b"".join([write.data for write in writes.values()]) if writes else b""
        if exchange is not None:
            self._begin(exchange, now, len(data))
            data += exchange.question.data
        self._free_at = max(now, self._free_at) + wire(len(data), self.baud)
        self._put(data)
        for write in writes.values():
            if not write.sent.done():
                write.sent.set_result(True)
        if exchange is None:
            self._go_on()
        else:
            self._arm()

    def _drop_old_writes(self, now: int) -> None:
        """Drop commands that waited while this process stood still: what they meant was another moment."""
        oldest = now - 2 * self.patience - STANDSTILL
        for key in [key for key, write in self._writes.items() if write.asked < oldest]:
            waited = self._writes.pop(key)
            if not waited.sent.done():
                late = describe(now - waited.asked)
                waited.sent.set_exception(DeviceError(f"a command waited for {late}, and was not sent any more."))

    def _next(self, now: int) -> Exchange | None:
        if self._urgent:
            return self._urgent.popleft()
        if self._asked:
            return self._asked.popleft()
        return None if self._polling is None else self._polling.next(now)

    def _begin(self, exchange: Exchange, now: int, before: int) -> None:
        """Note when an exchange goes to the line, after `before` bytes of commands, and until when it may take."""
        asked = exchange.question
        if asked.lengths:
            self._decoder.longest = max(asked.lengths) * 4 // 3  # stuffing adds a third at most
        takes = transaction(before + len(asked.data), asked.lengths, self.baud, self.return_delay)
        exchange.sent, exchange.until, exchange.garbage = now, max(now, self._free_at) + takes, self._garbage()
        self._deadline = exchange.until + (max(self.patience - HURRY, ms) if exchange.urgent else self.patience)

    def _put(self, data: bytes) -> None:
        assert self._line is not None
        try:
            self._line.write(data)
        except DisconnectedError as error:
            self._give_up(error)

    def _end(self, exchange: Exchange) -> None:
        """End an exchange, complete or not; send the next one, and then tell of this one."""
        self._exchange = None
        if exchange.over:
            self._free_at = 0
        else:
            for status in self._decoder.reset():
                exchange.take(status)
        exchange.until = self._now()
        self._counts["answers_missing"] += len(exchange.expected) - len(exchange.statuses)
        tell = exchange.ended(exchange)
        self._go_on()
        if tell is not None:
            tell()

    def _arm(self) -> None:
        """See to it that the timer fires no later than something is due; one that fires early looks again."""
        if self._exchange is not None:
            when = self._deadline
        elif self._polling is not None:
            when = self._polling.next_time()
        else:
            return
        if self._timer is not None:
            if self._wakes_at <= when:
                return
            self._timer.cancel()
        self._wakes_at = when
        self._timer = self._loop.call_at(when / 1e9, self._look)

    def _look(self) -> None:
        self._timer = None
        exchange = self._exchange
        if exchange is None:
            self._go_on()
        elif self._now() + TICK >= self._deadline:
            self._loop.call_at(self._loop.time(), self._expire, exchange)  # what has come is received before
        else:
            self._arm()

    def _expire(self, exchange: Exchange) -> None:
        """End an exchange whose deadline has passed, unless its answers were only waiting for a busy loop."""
        if exchange is self._exchange:
            self._end(exchange)

    # The end of it

    def _give_up(self, error: DisconnectedError) -> None:
        """End everything that is under way or waits."""
        self._line = self._polling = None
        lost, self._lost = self._lost, None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._drop_writes(error)
        for answers in list(self._answers):
            if not answers.done():
                answers.set_exception(error)
        self._clear()
        if lost is not None:
            lost(error)

    def _drop_writes(self, error: DeviceError) -> None:
        for write in self._writes.values():
            if not write.sent.done():
                write.sent.set_exception(error)
        self._writes.clear()

    def _garbage(self) -> int:
        return self._decoder.damaged + self._decoder.skipped

    def _check_open(self) -> None:
        if self._line is None:
            raise DisconnectedError("the bus is closed: open it first.")


def _settle(answers: asyncio.Future[Statuses]) -> Callable[[Exchange], None]:
    def ended(exchange: Exchange) -> None:
        if not answers.done():
            answers.set_result(exchange.statuses)

    return ended
