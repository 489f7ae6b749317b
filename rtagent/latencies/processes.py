"""Comparing two programs in processes of their own: what one process happens to be like meets a few rounds only."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from rtagent.errors import BaselineError
from rtagent.latencies import worker
from rtagent.latencies.comparison import Comparison, Verdict, compared
from rtagent.latencies.host import bound_to
from rtagent.latencies.rounds import Block, Measure, Round, Rules, Tell, sifted, taken

Command = Sequence[str]
"""What starts a worker."""

PAIRS = 3
"""Each side has so many processes, in turn: where things happen to lie in memory makes code quicker or slower."""

MOST = 2
"""So many times as many are measured where rounds are set aside."""

PATIENCE = 5.0
"""Seconds that a worker may take to end."""


class Worker:
    """A process that measures, and rests while it is not asked."""

    def __init__(self, name: str, command: Command) -> None:
        self.name = name
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)  # noqa: S603
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._pipes = self._process.stdin, self._process.stdout
        self.measure = Measure(self.times, Path(f"/proc/{self._process.pid}/schedstat"))

    def times(self) -> Block:
        """Run once and return the times."""
        block: Block = self.ask("times")
        return block

    def ask(self, job: str) -> Any:
        """Have a job done; raise `BaselineError` with what became of it where it failed."""
        questions, answers = self._pipes
        try:
            questions.write(f"{job}\n")
            questions.flush()
            answer = json.loads(answers.readline() or "{}")
        except BrokenPipeError:
            answer = {}
        if "done" not in answer:
            raise BaselineError(f"{self.name} cannot be measured: {_why(answer)}")
        return answer["done"]

    def close(self) -> None:
        """End it."""
        with suppress(BrokenPipeError):
            self._pipes[0].close()
        self._pipes[1].close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _why(answer: Mapping[str, str]) -> str:
    error = answer.get("error", "its process has ended.")
    lacks = answer.get("kind") in ("ImportError", "ModuleNotFoundError")
    return f"it is older than `rtagent bench`, or lacks a package ({error})." if lacks else error


def scenario_command(python: str | Path, scenario: str | Path, keys: Sequence[str]) -> Command:
    """Return what measures a scenario with the rtagent of an interpreter."""
    return [str(python), "-P", worker.__file__, str(scenario), *keys]


def _told(tell: Tell, number: int, pairs: int, line: str) -> None:
    tell(f"processes {number} of {pairs}: {line}")


@contextmanager
def workers(*sides: tuple[str, Command]) -> Iterator[Sequence[Worker]]:
    """Start a worker for each side, and end them."""
    started: list[Worker] = []
    try:
        for name, command in sides:
            started.append(Worker(name, command))
        yield started
    finally:
        for each in started:
            each.close()


def beside(
    before: tuple[str, Command],
    after: tuple[str, Command],
    rules: Rules,
    limit: float,
    pairs: int = PAIRS,
    tell: Tell = lambda line: None,
) -> tuple[Comparison, Sequence[Round]]:
    """Return how many times as long each thing takes `after`, and the rounds: processes of both take turns.

    Each of `pairs` pairs of processes measures its part of the rounds. As many again may follow: in place of rounds
    in which others had the processor, and while something looks slower than `limit` times and is not surely so.
    Raises `UndecidedError` where the machine was too busy, `BaselineError` where a side cannot be measured.
    """
    rounds, names = list[Round](), (before[0], after[0])
    for number in range(MOST * pairs):
        with bound_to(rules.processor), workers(before, after) as both:
            measures = [each.measure for each in both]
            rounds += taken(measures, rules, -(-rules.rounds // pairs), partial(_told, tell, number + 1, pairs))
        if _suffice(names, rounds, rules, limit):
            break
    found = sifted(rounds, rules)
    return compared(*names, found, rules), found.kept


def _suffice(names: tuple[str, str], rounds: Sequence[Round], rules: Rules, limit: float) -> bool:
    """Say whether enough rounds count, and all of them together tell what is slower."""
    if sum(each.lost <= rules.stolen for each in rounds) < rules.rounds:
        return False
    ratios = compared(*names, sifted(rounds, rules), rules).ratios.values()
    return not any(ratio.verdict(limit) is Verdict.UNSURE for ratio in ratios)
