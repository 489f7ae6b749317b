"""The runs of learned ordering: the worlds, the schedules, and what is kept of each run."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from rtagent import clock
from rtagent.experience import Observation
from rtagent.experiments.experiment import Cell, Options, Row
from rtagent.experiments.scenarios import scenario
from rtagent.instruments import Instrument
from rtagent.learn import Where
from rtagent.recorder import EpisodeRecord
from rtagent.result import Result
from rtagent.scenario import assemble, load
from rtagent.schedule import FIXED, Component
from rtagent.units import second

LEARNED, RANDOM, FORETOLD = "learned", "random ordering", "deferred, foretold"
SCHEDULES = (*FIXED, FORETOLD, RANDOM, LEARNED)
SEEDS, QUICK_SEEDS = 20, 4
PARTS = 12
"""A run is told in so many parts of equal length."""


class World(NamedTuple):
    """A scenario: how long it runs, which sensor says since when it is urgent, and when a demon foretells it.

    `length` is in seconds of one long episode, or in episodes, as `per` says. `urgent` is a sensor of its one
    device and the value above which it is so; `foretold` is a demon and such a value. `takes` is how long a unit of
    its length takes to compute, in s: with a list, and with an order that is decided on.
    """

    length: int
    per: str
    urgent: tuple[str, float]
    foretold: tuple[str, float]
    takes: tuple[float, float]


WORLDS = {
    "phases": World(840, "second", ("busy", 0.5), ("traffic γ=0.4/s", 1.0), (0.0017, 0.008)),
    "phases_rewired": World(840, "second", ("busy", 0.5), ("traffic γ=0.4/s", 1.0), (0.0045, 0.015)),
    "phases_stopping": World(300, "episode", ("position", 2.09), ("emergency γ=0.4/s", 0.1), (0.0055, 0.017)),
}
QUICK = 3
"""Quick runs are shorter by this factor."""
OWN_SETTINGS: Mapping[str, Sequence[str]] = {
    "interruptible": ["learn.slice=1ms"],  # its own of 40 µs takes long to compute, and reacts 1 ms sooner
    RANDOM: ["schedule.preset=learned", "schedule.ordering.epsilon=1.0"],
}


def cells(options: Options) -> Sequence[Cell]:
    """Return a cell for each world, schedule and seed."""
    count, shorter = (QUICK_SEEDS, QUICK) if options.quick else (SEEDS, 1)
    return [
        {"world": name, "schedule": schedule, "seed": seed, "length": world.length // shorter}
        for name, world in WORLDS.items()
        for schedule in SCHEDULES
        for seed in range(1, count + 1)
    ]


def seconds(cell: Cell) -> float:
    """Estimate how long a cell takes: the more decisions, the longer."""
    listed, decided = WORLDS[cell["world"]].takes
    return float(cell["length"] * (decided if cell["schedule"] in (LEARNED, RANDOM) else listed))


def measure(cell: Cell) -> Row:
    """Run a cell under the virtual clock."""
    world = WORLDS[cell["world"]]
    ledger = Ledger(*world.urgent)
    loaded = load(scenario(cell["world"]), settings(cell))
    result = clock.run(assemble(loaded).run([ledger]), "virtual")
    earned = result_by_parts(result) if world.per == "episode" else ledger.by_parts()
    times = np.array(result.reaction_times) / 1e6
    return {
        "earned": earned,
        "reaction_ms": [float(each) for each in np.quantile(times, (0.1, 0.5, 0.9))],
        "missed": result.reaction_time.missed,
        "learned": sum(result.learning().counts.values()),
        "shares": ledger.shares(),
    }


def settings(cell: Cell) -> list[str]:
    """Return what a cell sets in the scenario of its world."""
    world, schedule = WORLDS[cell["world"]], cell["schedule"]
    said = [f"run.seed={cell['seed']}"]
    said += [f"run.episodes={cell['length']}" if world.per == "episode" else f"run.episode_time={cell['length']}s"]
    if schedule == FORETOLD:
        demon, above = world.foretold
        return [*said, "schedule.preset=deferred", f'learn.urgent={{ prediction = "{demon}", above = {above} }}']
    if schedule in FIXED:
        said.append(f"schedule.preset={schedule}")
    return said + list(OWN_SETTINGS.get(schedule, ()))


def result_by_parts(result: Result) -> list[float]:
    """Return the mean return of an episode in each part of a run."""
    returns = [episode.total_reward for episode in result.episodes]
    return [float(part.mean()) for part in np.array_split(np.array(returns), PARTS)]


class Ledger(Instrument):
    """What was earned until when, and how long each component ran, in calm and in urgent phases.

    It is urgent while the sensor `urgent` is above a value, as the newest observation shows it.
    """

    def __init__(self, urgent: str, above: float) -> None:
        self._urgent, self._above = urgent, above
        self._times: list[int] = []
        self._rewards: list[float] = []
        self._ran: dict[str, Counter[str]] = defaultdict(Counter)
        self._lasted: Counter[str] = Counter()
        self._phase, self._since, self._ended = "calm", 0, 0

    def episode_began(self, trial: int, episode: int, time: int) -> None:
        """Begin with a calm phase."""
        self._phase, self._since = "calm", time
        if not self._times:
            self._times.append(time)
            self._rewards.append(0.0)

    def observed(self, observation: Observation, stimuli: object) -> None:
        """Take what was earned, and which phase it is."""
        (sample,) = observation.samples.values()
        self._times.append(observation.time)
        self._rewards.append(float(sample.values["reward"]))
        self._turn("urgent" if sample.values[self._urgent] > self._above else "calm", observation.time)

    def component(self, component: Component, start: int, end: int) -> None:
        """Take how long a component ran."""
        self._take(component.value, start, end)

    def learned_for(self, start: int, end: int, where: Where) -> None:
        """Take how long was learned, in a slice or elsewhere."""
        self._take("learn", start, end)

    def episode_ended(self, record: EpisodeRecord) -> None:
        """End the last phase, with what was learned at the end of the episode."""
        self._turn("calm", max(record.ended, self._ended))

    def by_parts(self) -> list[float]:
        """Return what was earned in a second, in each part of a run of one episode."""
        ends = np.linspace(self._times[0], self._times[-1], PARTS + 1)
        earned = np.interp(ends, self._times, self._rewards)
        return [float(each) for each in np.diff(earned) / np.diff(ends) * second]

    def shares(self) -> dict[str, dict[str, Any]]:
        """Return which share of the time of each kind of phase went into each component."""
        return {
            phase: {component: ran / self._lasted[phase] for component, ran in sorted(parts.items())}
            for phase, parts in sorted(self._ran.items())
            if self._lasted[phase]
        }

    def _take(self, component: str, start: int, end: int) -> None:
        self._ran[self._phase][component] += end - start
        self._ended = end

    def _turn(self, phase: str, now: int) -> None:
        self._lasted[self._phase] += now - self._since
        self._phase, self._since = phase, now
