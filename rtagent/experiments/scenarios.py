"""Where the scenario files of the experiments are: in the repository, or in the installed package."""

from __future__ import annotations

from pathlib import Path

from rtagent.errors import ScenarioError, did_you_mean

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


def names() -> list[str]:
    """Return the names of all scenarios that are there."""
    return sorted({path.stem for folder in FOLDERS for path in folder.glob("*.toml")})
