"""What all tests share: no deadline but their own, and a home that is not this user's."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings

settings.register_profile("shared machines", deadline=None)
settings.load_profile("shared machines")


@pytest.fixture(autouse=True, scope="session")
def homes_of_their_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What stays latched after a run, and which runs live, is kept apart from what this user has."""
    before = dict(os.environ)
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))
    os.environ["XDG_RUNTIME_DIR"] = str(tmp_path_factory.mktemp("runtime"))
    yield
    os.environ.clear()
    os.environ.update(before)
