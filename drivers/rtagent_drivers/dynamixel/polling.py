"""Reading a bus in rounds. A servo that does not answer is left out, and asked again less and less often."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from rtagent.units import ms, second, us
from rtagent_drivers.dynamixel.exchange import Exchange, Question, Statuses
from rtagent_drivers.dynamixel.orders import questions
from rtagent_drivers.dynamixel.packets import Codec, Span, Status

FIRST_PAUSE, LONGEST_PAUSE = 10 * ms, 1 * second
"""A silent servo is asked again at once, then after the one, then after twice as long, at last after the other."""

TICK = 1 * us
"""Timers of asyncio may fire a nanosecond early."""


class Round(NamedTuple):
    """The answers of one round, asked for and complete at these times (ns)."""

    statuses: Mapping[int, Status]
    sent: int
    ended: int


@dataclass
class _Silence:
    pause: int
    ask_at: int


class Roster:
    """Who is asked in a round: `together` by a group read, and `singly` those that know none."""

    def __init__(self, codec: Codec, together: Sequence[Span], singly: Sequence[Span] = ()) -> None:
        self._codec = codec
        self._together = {span.servo: span for span in together}
        self._singly = {span.servo: span for span in singly}
        self._silent: dict[int, _Silence] = {}
        self.questions = self._ask()
        """What is asked in a round: of all servos that are not silent."""

    def heard(self, exchange: Exchange, now: int) -> None:
        """Note who answered. Of those that did not, the first in order is held to be the silent one.

        The others may have waited for it in vain: servos answer a group read one after the other.
        """
        missing = _first_missing(exchange)
        if missing is None and not self._silent:
            return
        for servo in exchange.statuses:
            self._silent.pop(servo, None)
        if missing is not None:
            before = self._silent.get(missing)
            pause = 0 if before is None else min(max(2 * before.pause, FIRST_PAUSE), LONGEST_PAUSE)
            self._silent[missing] = _Silence(pause, now + pause)
        self.questions = self._ask()

    def probe(self, now: int) -> Question | None:
        """Return a question to a silent servo whose time has come."""
        due = [servo for servo, silence in self._silent.items() if silence.ask_at <= now]
        return self._single(due[0]) if due else None

    def next_probe(self) -> int | None:
        """Return when (ns) a silent servo is to be asked again, or None where none is silent."""
        return min((silence.ask_at for silence in self._silent.values()), default=None)

    def _ask(self) -> Sequence[Question]:
        together, singly = (
            [span for servo, span in spans.items() if servo not in self._silent]
            for spans in (self._together, self._singly)
        )
        return questions(self._codec, together, singly)

    def _single(self, servo: int) -> Question:
        span = self._singly[servo] if servo in self._singly else self._together[servo]
        return questions(self._codec, [], [span])[0]


def _first_missing(exchange: Exchange) -> int | None:
    if len(exchange.statuses) == len(exchange.expected):
        return None
    return next(servo for servo in exchange.expected if servo not in exchange.statuses)


class Polling:
    """Rounds of a roster, `period` (ns) apart on absolute deadlines, or as fast as the line goes."""

    def __init__(self, roster: Roster, period: int, hear: Callable[[Round], None], now: int) -> None:
        self.roster, self._period, self._hear = roster, period, hear
        self.due = now
        self._left: deque[Question] = deque()
        self._statuses: Statuses = {}
        self._sent = 0

    def next(self, now: int) -> Exchange | None:
        """Return what is to be asked now."""
        if self._left:
            return Exchange(self._left.popleft(), self._answered)
        probe = self.roster.probe(now)
        if probe is not None:
            return Exchange(probe, self._probed)
        if now + TICK < self.due:
            return None
        self.due = max(self.due + self._period, now)
        self._left.extend(self.roster.questions)
        self._statuses, self._sent = {}, now
        return Exchange(self._left.popleft(), self._answered) if self._left else None

    def next_time(self) -> int:
        """Return when (ns) something is to be asked next."""
        probe = self.roster.next_probe()
        if not self.roster.questions and probe is not None:
            return probe
        return self.due if probe is None else min(self.due, probe)

    def _answered(self, exchange: Exchange) -> Callable[[], None] | None:
        self.roster.heard(exchange, exchange.until)
        self._statuses |= exchange.statuses
        if self._left:
            return None
        finished = Round(self._statuses, self._sent, exchange.until)
        return lambda: self._hear(finished)

    def _probed(self, exchange: Exchange) -> Callable[[], None] | None:
        """Note whether a silent servo answers again; it takes part in the next round."""
        self.roster.heard(exchange, exchange.until)
        if self.roster.questions:
            return None
        nothing = Round({}, exchange.sent, exchange.until)
        return lambda: self._hear(nothing)
