"""Which runs a sweep is: every combination of the values of its keys, each with several seeds."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import product
from typing import Any

from rtagent.errors import ScenarioError
from rtagent.scenario import Scenario, assemble, load

Values = Mapping[str, Any]


@dataclass(frozen=True)
class Run:
    """One run: the values of the swept keys, its seed, and the scenario with everything resolved."""

    values: Values
    seed: int
    scenario: Mapping[str, Any]


@dataclass(frozen=True)
class Plan:
    """All runs of a sweep, in order; `real`: some are under the real clock; `guarded`: they move something real."""

    name: str
    runs: Sequence[Run]
    combinations: int
    real: bool
    guarded: bool


def parse_over(text: str) -> tuple[str, list[Any]]:
    """Return the key and the values of `key=a,b,c`, each as TOML has it, else as text; raise `ScenarioError`."""
    key, equals, values = text.partition("=")
    names = [name.strip() for name in key.split(".")]
    if not equals or not all(names) or not values.strip():
        raise ScenarioError(
            [f"--over {text}: write it as key=value,value, such as --over schedule.preset=standard,reactive."]
        )
    return ".".join(names), _values(values)


def plan(path: str, overrides: Sequence[str], over: Sequence[str], trials: int | None = None) -> Plan:
    """Return the runs of a scenario's sweep; raise `ScenarioError` with all that is wrong with any of them.

    `over` are texts as `parse_over` takes them, beside those of the table [sweep] or, for one key, in their place;
    `trials` is how many runs each combination has, if not as many as the table says.
    """
    base = load(path, overrides)
    table = base.model.sweep
    swept = {**(table.over if table else {}), **dict(map(parse_over, over))}
    if trials is not None and trials < 1:
        raise ScenarioError([f"--trials {trials}: give 1 or more."])
    if "sweep" in {key.split(".")[0] for key in swept}:
        raise ScenarioError(["a sweep over keys of [sweep] itself makes no sense: name keys of other tables."])
    count = trials if trials is not None else table.trials if table else 1
    combinations = [dict(zip(swept, values, strict=True)) for values in product(*swept.values())]
    loaded = _loaded(path, overrides, combinations)
    runs = [run for each, values in zip(loaded, combinations, strict=True) for run in _runs(each[0], values, count)]
    real = any(scenario.model.run.clock == "real" for scenario, _ in loaded)
    return Plan(base.name, runs, len(combinations), real, guarded=any(guarded for _, guarded in loaded))


def _loaded(path: str, overrides: Sequence[str], combinations: Sequence[Values]) -> list[tuple[Scenario, bool]]:
    """Return the scenario of each combination, and whether it moves something real."""
    loaded, problems = list[tuple[Scenario, bool]](), dict[str, str]()  # a problem of many is told once
    for values in combinations:
        texts = [f"{key}={_toml(value)}" for key, value in values.items()]
        try:
            scenario = load(path, [*overrides, *texts])
            guarded = assemble(scenario).guarded
        except ScenarioError as error:
            for problem in error.problems:
                problems.setdefault(problem, _with_values(problem, texts))
        else:
            loaded.append((scenario, guarded))
    if problems:
        raise ScenarioError(list(problems.values()))
    return loaded


def _with_values(problem: str, texts: Sequence[str]) -> str:
    """Name the option that a value came from, or else all of the combination."""
    if any(problem.startswith(f"--set {text}: ") for text in texts):
        return problem.replace("--set ", "--over ", 1)
    return f"{problem.rstrip('.')} (with {', '.join(texts)})." if texts else problem


def _runs(scenario: Scenario, values: Values, count: int) -> Iterator[Run]:
    resolved = scenario.resolved()
    resolved.pop("sweep", None)
    for trial in range(count):
        own = deepcopy(resolved)
        own["run"]["seed"] = seed = scenario.model.run.seed + trial
        yield Run(values, seed, own)


def _values(text: str) -> list[Any]:
    """Return a list as TOML has it, else what stands between the commas, each as TOML has it or as text."""
    try:
        return list(tomllib.loads(f"values = [{text}]")["values"])
    except tomllib.TOMLDecodeError:
        return [_value(part.strip()) for part in text.split(",")]


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _toml(value: Any) -> str:
    """Write a value as TOML has it in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else str(value)
