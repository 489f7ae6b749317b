"""One exchange on a bus: a request, and the answers that come to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rtagent_drivers.dynamixel.packets import Codec, Request, Status

Statuses = dict[int, Status]


@dataclass(frozen=True)
class Question:
    """The bytes of requests of which the last is answered, with how many bytes each servo answers, in order."""

    data: bytes
    expected: dict[int, int]
    lengths: tuple[int, ...]
    """Of the packets that answer."""


def question(codec: Codec, expected: dict[int, int], *requests: Request) -> Question:
    """Return the question that `requests` ask; `expected` has how many bytes each servo answers to the last."""
    lengths = tuple(codec.status_length(length) for length in expected.values())
    return Question(b"".join(map(codec.request, requests)), expected, lengths)


class Exchange:
    """A question on the line, with the answers that have come.

    `ended` is called when no more are waited for; what it returns is called once the next one is on its way.
    """

    __slots__ = ("ended", "expected", "garbage", "last", "question", "sent", "statuses", "until", "urgent")

    def __init__(
        self, question: Question, ended: Callable[[Exchange], Callable[[], None] | None], urgent: bool = False
    ) -> None:
        self.question, self.ended, self.urgent = question, ended, urgent
        self.expected = question.expected
        self.last = next(reversed(self.expected), None)
        self.statuses: Statuses = {}
        self.sent = self.until = self.garbage = 0

    def take(self, status: Status) -> bool:
        """Take an answer; say whether it is one of those that are expected."""
        length = self.expected.get(status.servo)
        if length is None or status.servo in self.statuses:
            return False
        if len(status.parameters) != length and not status.error:
            return False
        self.statuses[status.servo] = status
        return True

    @property
    def over(self) -> bool:
        """Whether no further answer can come: servos answer in order."""
        return self.last in self.statuses or not self.expected
