"""Whether a checkpoint is of the scenario that is to go on from it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

AGENT = ("task", "features", "learner", "horde", "policy")
"""Tables that make the agent: what was learned fits no other."""

WORLD = ("devices", "schedule", "learn", "costs")
RUN = ("clock", "fake", "seed", "episode_time", "episode_steps")
"""Tables, and keys of `run`, that a run under the virtual clock needs to go on as if it had never stopped."""


def misfits(kept: Mapping[str, Any], scenario: Mapping[str, Any]) -> list[str]:
    """Return a clause for each setting of a resolved `scenario` that is another than in the one that was `kept`.

    Where either ran, or runs, under the real clock, only what makes the agent counts.
    """
    now: Mapping[str, Any] = json.loads(json.dumps(scenario))
    exact = all(each.get("run", {}).get("clock") == "virtual" for each in (kept, now))
    pairs = [(table, kept.get(table), now.get(table)) for table in AGENT + (WORLD if exact else ())]
    if exact:
        pairs += [(f"run.{key}", kept["run"].get(key), now["run"].get(key)) for key in RUN]
    return [clause for name, then, here in pairs for clause in differences(name, then, here)]


def differences(name: str, then: Any, here: Any) -> Iterator[str]:
    """Yield a clause for each setting in which two tables, called `name`, differ; no name: whole scenarios."""
    if isinstance(then, Mapping) and isinstance(here, Mapping):
        for key in sorted(then.keys() | here.keys()):
            yield from differences(f"{name}.{key}".lstrip("."), then.get(key), here.get(key))
    elif isinstance(then, list) and isinstance(here, list) and len(then) == len(here):
        for place, (one, other) in enumerate(zip(then, here, strict=True)):
            yield from differences(f"{name}.{place}", one, other)
    elif then != here:
        yield f"{name} was {_written(then)} and is {_written(here)}"


def _written(value: Any) -> str:
    text = "not there" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."
