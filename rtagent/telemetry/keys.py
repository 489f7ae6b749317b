"""The keys of a run on Zenoh."""

from __future__ import annotations

import re
from typing import NamedTuple

DATA = "rtagent"
CONTROL = "rtagent-control"
ALL = f"{DATA}/**"


class Place(NamedTuple):
    """A run among those of an agent."""

    agent: str
    run_id: str

    @property
    def run(self) -> str:
        """The key of its liveliness token."""
        return f"{DATA}/{self.agent}/{self.run_id}"

    def key(self, stream: str) -> str:
        """Return the key of a stream; a queryable there answers with its newest record."""
        return f"{self.run}/{stream}"

    def schema(self, stream: str) -> str:
        """Return the key at which a queryable answers with the schema of a stream."""
        return f"{self.run}/@schema/{stream}"

    def control(self, command: str) -> str:
        """Return the key at which a queryable takes a command: stop, annotate or press."""
        return f"{CONTROL}/{self.agent}/{self.run_id}/{command}"


def as_chunk(name: str) -> str:
    """Return a name as one part of a key."""
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "agent"


def place_of(key: str) -> Place:
    """Return the run that a key belongs to."""
    _, agent, run_id, *_ = key.split("/")
    return Place(agent, run_id)
