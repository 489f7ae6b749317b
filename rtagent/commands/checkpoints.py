"""What `rtagent run` keeps, and what it goes on from."""

from __future__ import annotations

from pathlib import Path

from rtagent import __version__
from rtagent.checkpoint.file import Checkpoint, read
from rtagent.checkpoint.fit import misfits
from rtagent.checkpoint.keeper import Keeper, Rules
from rtagent.errors import CheckpointError
from rtagent.scenario import Scenario


def keeper_of(scenario: Scenario, *, resume: bool) -> Keeper | None:
    """Return what keeps checkpoints as a scenario says, if it does, with the one that is to be gone on from.

    Raises `CheckpointError` where that cannot be, or where a checkpoint would be lost.
    """
    table = scenario.model.checkpoint
    if not table.file:
        if resume:
            raise CheckpointError("--resume needs a checkpoint to go on from: give --checkpoint FILE.")
        return None
    path = Path(table.file)
    _check_place(path, resume)
    resumed = read(path) if resume else None
    if resumed is not None:
        _check_fit(path, resumed, scenario)
    about = {"rtagent": __version__, "scenario": scenario.resolved()}
    return Keeper(path, Rules(table.every, table.episodes, table.step), about, resumed)


def told(keeper: Keeper, checkpoint: Checkpoint) -> str:
    """Return a line on where a run goes on."""
    place = checkpoint.saved["place"]
    when = "in the middle of" if place["open"] else "after"
    where = f"trial {place['trial'] + 1}, {when} episode {place['episodes']}"
    world = "" if checkpoint.saved["world"] else ", with what was learned; the next episode begins anew"
    return f"goes on from {keeper.path}: {where}{world}"


def _check_place(path: Path, resume: bool) -> None:
    if path.is_dir() or not path.parent.is_dir():
        raise CheckpointError(f"no checkpoint can be kept in {path}: give a file in a folder that exists.")
    if path.exists() and not resume:
        raise CheckpointError(
            f"{path} is there already, and would be lost: go on from it with --resume, or give another file."
        )


def _check_fit(path: Path, checkpoint: Checkpoint, scenario: Scenario) -> None:
    found = misfits(checkpoint.about.get("scenario", {}), scenario.resolved())
    if found:
        more = f", and {len(found) - 3} more settings differ" if len(found) > 3 else ""
        raise CheckpointError(
            f"{path} is of another scenario: {'; '.join(found[:3])}{more}. Go on with the one that it is of."
        )
