"""Parts of runs that several tests share: the stopping task and its agent, and ways to run them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from numpy.random import Generator

from rtagent import Agent, Limits, Plan, Result, Schedule, Supervision, clock, ms, run, second
from rtagent.checkpoint.keeper import Keeper
from rtagent.clock import ClockName
from rtagent.device import Device
from rtagent.features import Tabular
from rtagent.learning import Sarsa
from rtagent.policy import Greedy
from rtagent.task import Task
from rtagent.tasks import Stopping
from rtagent_drivers.stopping import stopping_joint

ROOT = Path(__file__).parent.parent
SCENARIOS = ROOT / "scenarios"


def sarsa_agent(task: Task) -> Callable[[Generator], Agent]:
    def make(rng: Generator) -> Agent:
        features = Tabular(state=task.state)
        return Agent(features, Sarsa(size=features.size, actions=len(task.actions)), Greedy(), rng)

    return make


def run_stopping(
    preset: str = "reactive",
    *,
    delay: int = 50 * ms,
    joint: Device | None = None,
    task: Task | None = None,
    agent: Callable[[Generator], Agent] | None = None,
    trials: int = 1,
    episodes: int = 5,
    seed: int = 0,
    clock_name: ClockName = "virtual",
    instruments: Iterable[object] = (),
    supervision: Mapping[str, Supervision] | None = None,
    keeper: Keeper | None = None,
    **schedule: object,
) -> Result:
    """Run the stopping task; everything that is not given is as in the thesis."""
    task = task or Stopping()
    plan = Plan(trials, episodes, seed, Limits(episode_time=10 * second))

    async def main() -> Result:
        return await run(
            {"joint": joint or stopping_joint()},
            task,
            agent or sarsa_agent(task),
            Schedule.preset(preset, learn_delay=delay, **schedule),
            plan,
            instruments=instruments,
            supervision=supervision,
            keeper=keeper,
        )

    return clock.run(main(), clock_name)
