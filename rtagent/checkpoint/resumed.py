"""A checkpoint as a run that goes on from it sees it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rtagent.errors import CheckpointError
from rtagent.saving import Saved

PARTS = ("place", "now", "age", "recorder", "agents", "runtime", "world")


class Resumed:
    """Where a run goes on: in which `trial`, how many `episodes` of it have begun, and whether the last is `open`.

    `exact`: the world was saved too, and the run goes on as if it had never stopped. Otherwise it goes on with the
    next episode, and with all that was learned.
    """

    def __init__(self, saved: Saved, virtual: bool) -> None:
        self.saved = saved
        with fitting():
            for part in PARTS:
                saved[part]
            place = saved["place"]
            self.trial: int = place["trial"]
            self.episodes: int = place["episodes"]
            self.open: bool = place["open"]
            self.exact = virtual and saved["world"] is not None

    def agent(self, trial: int) -> Saved | None:
        """Return the saved agent of a trial, if there is one."""
        agents: list[Saved] = self.saved["agents"]
        return agents[trial] if trial < len(agents) else None


@contextmanager
def fitting() -> Iterator[None]:
    """Raise `CheckpointError` for whatever shows, within the block, that a checkpoint does not fit the run."""
    try:
        yield
    except CheckpointError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        said = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise CheckpointError(f"the checkpoint does not fit this run: {said.rstrip('.')}.") from None
