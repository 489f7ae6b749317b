"""A process that measures an agent one of whose parts does some work more: `python _slowed.py PART WORK`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Coroutine, Generator
from itertools import repeat
from pathlib import Path
from typing import Any

from rtagent import Agent, Result, Transition
from rtagent.experience import Command, Observation, Outcome
from rtagent.latencies import Subject
from rtagent.latencies.worker import jobs_of, serve
from rtagent.scenario import Assembly, assemble, load

SCENARIO = Path(__file__).parent.parent / "scenarios" / "stopping_horde.toml"
KEYS = (
    "run.episodes=12",
    "run.episode_time=1s",
    "devices.joint.onset=['4ms', '12ms']",
    "devices.arm.sampling.rate=500Hz",
)
DELAY = 5_000_000
"""How long (ns) a sample of the arm is on its way."""

Work = Callable[[], None]


def work(amount: int) -> Work:
    """Return what does so much work, each unit of which takes as long."""

    def do() -> None:
        for _ in repeat(None, amount):
            pass

    return do


def slow_observe(assembly: Assembly, more: Work) -> None:
    interpret = assembly.task.interpret

    def slowed(observation: Observation) -> Outcome:
        more()
        return interpret(observation)

    assembly.task.interpret = slowed  # type: ignore[method-assign]


def slow_choose(assembly: Assembly, more: Work) -> None:
    def slow(agent: Agent) -> None:
        policy = agent.policy
        assert policy is not None
        choose = policy.choose

        def slowed(*given: Any) -> tuple[int, float]:
            more()
            return choose(*given)

        policy.choose = slowed  # type: ignore[method-assign]

    _change_agent(assembly, slow)


def slow_act(assembly: Assembly, more: Work) -> None:
    device = assembly.devices["joint"]
    act = device.act

    async def slowed(command: Command) -> Command:
        more()
        return await act(command)

    device.act = slowed  # type: ignore[method-assign]


def slow_pieces(assembly: Assembly, more: Work) -> None:
    def slow(agent: Agent) -> None:
        updating = agent.learner.updating

        def slowed(transition: Transition) -> Generator[bool | None, None, float]:
            pieces = updating(transition)
            while True:
                more()
                try:
                    apart = next(pieces)
                except StopIteration as done:
                    return done.value
                yield apart

        agent.learner.updating = slowed

    _change_agent(assembly, slow)


def _change_agent(assembly: Assembly, change: Callable[[Agent], None]) -> None:
    make = assembly.make_agent

    def changed(*given: Any) -> Agent:
        agent = make(*given)
        change(agent)
        return agent

    assembly.make_agent = changed


PARTS: dict[str, Callable[[Assembly, Work], None]] = {
    "age of arm": lambda assembly, more: None,
    "observe": slow_observe,
    "choose": slow_choose,
    "act": slow_act,
    "slice": slow_pieces,
    "learning": slow_pieces,
}
"""What can be slower: the times that it is found by, and how it is made so."""

ONE_PIECE = "learn.slice=1us"
"""Else a slice has so many pieces as fit into its time, and is no longer where they are."""


def subject(part: str, amount: int) -> Subject:
    """Return the agent with a part that does so much more: work, or for an age ns of delay."""
    delay = DELAY + (amount if part == "age of arm" else 0)
    slices = [ONE_PIECE] * (part == "slice")
    scenario = load(SCENARIO, [*KEYS, *slices, f"devices.arm.sampling.delay={delay}ns"])

    def runs() -> Coroutine[Any, Any, Result]:
        assembly = assemble(scenario)
        PARTS[part](assembly, work(amount))
        return assembly.run()

    return Subject.of(runs, "real", part)


if __name__ == "__main__":
    part, amount = sys.argv[1], int(sys.argv[2])
    serve(jobs_of(lambda: subject(part, amount)))
