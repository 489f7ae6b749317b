"""The scenario files of the experiments, in the repository or in the installed package, and running them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rtagent import clock
from rtagent.errors import ScenarioError, did_you_mean
from rtagent.result import Result
from rtagent.scenario import assemble, load

PACKAGE = Path(__file__).parent.parent
FOLDERS = (PACKAGE.parent / "scenarios", PACKAGE / "_scenarios")
"""The repository's first: beside it an editable installation may have an old copy."""


def scenario(name: str) -> Path:
    """Return the file of a scenario, such as "stopping"; raise `ScenarioError` where there is none."""
    for folder in FOLDERS:
        path = folder / f"{name}.toml"
        if path.is_file():
            return path
    raise ScenarioError([f"there is no scenario {name!r} in this installation{did_you_mean(name, names())}"])


def run_scenario(name: str, overrides: Sequence[str] = ()) -> Result:
    """Run a scenario, with what `overrides` set (texts key=value), under the clock that it names."""
    loaded = load(scenario(name), overrides)
    return clock.run(assemble(loaded).run(), loaded.model.run.clock)


def names() -> list[str]:
    """Return the names of all scenarios that are there."""
    return sorted({path.stem for folder in FOLDERS for path in folder.glob("*.toml")})
