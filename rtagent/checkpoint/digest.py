"""A digest of what an agent has learned: two that have learned the same have the same one."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtagent.agent import Agent
from rtagent.checkpoint.file import packed
from rtagent.saving import Saveable


def digest_of(agent: Agent) -> str:
    """Return the SHA-256 digest of a learner's state, or "" where it cannot be saved."""
    if not isinstance(agent.learner, Saveable):
        return ""
    arrays: list[NDArray[Any]] = []
    digest = hashlib.sha256(json.dumps(packed(agent.learner.save(), arrays), sort_keys=True).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
